// Where many robots are in the window, a map of density: one disc for the robots of each square of the screen, as large as
// they are many, in the colour of the team that most of them have. Silent robots have discs of their own, above the others.

import { flagsOf, hasPlace, LOST, RECORD, slotOf, STALE } from "./frame.js";

/** @typedef {import("./frame.js").Frame} Frame */

/** The width of a square in pixels. */
export const SQUARE = 14;
/** Discs have so many sizes; the largest touches its neighbours. */
export const SIZES = 63;
/** From so many robots on, a disc has its full size. */
const FULL = 64;

/** The size of the disc for so many robots: it grows with the logarithm. @param {number} count */
export const discSize = (count) => Math.round(SIZES * Math.min(1, Math.log2(1 + count) / Math.log2(1 + FULL)));

/**
 * The discs for a frame. Robots that the filter leaves out are left out, and those outside the window as well.
 *
 * @param {Frame} frame
 * @param {Uint8Array} marks one per robot, as the painter takes them
 * @param {[number, number]} corner column and row of the left upper corner of the window
 * @param {number} pixel columns, and rows, per pixel
 * @param {[number, number]} window its width and height in pixels
 * @returns {{frame: Frame, marks: Uint8Array, robots: number}} a frame with one record per disc; the marks have the size in
 *     their upper six bits; `robots` is how many there are in all discs
 */
export function discs(frame, marks, corner, pixel, [width, height]) {
    const columns = Math.ceil(width / SQUARE);
    const squares = columns * Math.ceil(height / SQUARE);
    // The discs of all squares, and behind them those of their silent robots.
    const counts = new Uint32Array(2 * squares);
    const sums = new Float64Array(4 * squares);
    const chosen = new Uint8Array(2 * squares);
    const flags = new Uint8Array(2 * squares);
    /** @type {Map<number, number>} how many robots of a team a disc has */
    const teams = new Map();
    let robots = 0;
    for (let index = 0; index < frame.count; index++) {
        if (!hasPlace(frame, index) || marks[index] & 2) continue;
        const [column, row] = [frame.shorts[4 * index], frame.shorts[4 * index + 1]];
        const x = (column - corner[0]) / pixel;
        const y = (corner[1] - row) / pixel;
        if (x < 0 || y < 0 || x >= width || y >= height) continue;
        const silent = flagsOf(frame, index) & (STALE | LOST);
        const disc = Math.floor(y / SQUARE) * columns + Math.floor(x / SQUARE) + (silent ? squares : 0);
        counts[disc] += 1;
        sums[2 * disc] += column;
        sums[2 * disc + 1] += row;
        chosen[disc] |= marks[index] & 1;
        flags[disc] |= silent;
        const key = disc * 65536 + slotOf(frame, index);
        teams.set(key, (teams.get(key) ?? 0) + 1);
        robots += 1;
    }
    const most = new Uint32Array(2 * squares);
    const slots = new Uint16Array(2 * squares);
    for (const [key, count] of teams) {
        const disc = Math.floor(key / 65536);
        if (count > most[disc]) [most[disc], slots[disc]] = [count, key % 65536];
    }
    const taken = [...counts.keys()].filter((disc) => counts[disc] > 0);
    const bytes = new Uint8Array(RECORD * taken.length);
    const shorts = new Uint16Array(bytes.buffer);
    const sizes = new Uint8Array(taken.length);
    taken.forEach((disc, at) => {
        shorts[4 * at] = Math.round(sums[2 * disc] / counts[disc]);
        shorts[4 * at + 1] = Math.round(sums[2 * disc + 1] / counts[disc]);
        shorts[4 * at + 2] = slots[disc];
        // No heading.
        bytes[RECORD * at + 6] = 255;
        bytes[RECORD * at + 7] = flags[disc];
        sizes[at] = chosen[disc] | (discSize(counts[disc]) << 2);
    });
    const made = { ...frame, count: taken.length, bytes, shorts, words: new Uint32Array(bytes.buffer) };
    return { frame: made, marks: sizes, robots };
}
