// The fleet at a moment of the past, in the form in which the map has the live one.

import { GROUND, LEADER, NONE, RECORD, STALE } from "./frame.js";

/** Columns and rows of a frame; the last number says that a robot has no place. */
const CELLS = NONE - 1;
/** The least width of a cell in metres: what a history rounds to. */
const LEAST_CELL = 0.01;
/** The heading of robots whose heading is not known. */
const NO_HEADING = 255;

/**
 * @param {any} division a division as the history has it
 * @returns {any} the fields of the page's state that a map is drawn from
 */
export function pastWorld(division) {
    /** @type {Map<string, number>} */
    const slots = new Map();
    const leaders = new Set();
    division.teams.forEach((/** @type {any} */ team, /** @type {number} */ slot) => {
        for (const robot of team.members) slots.set(robot, slot);
        if (team.leader) leaders.add(team.leader);
    });
    const stale = new Set(division.stale);
    const names = [...new Set([...slots.keys(), ...division.unassigned, ...stale])].sort();
    const places = Object.values(division.positions);
    const low = [0, 1].map((axis) => places.reduce((least, place) => Math.min(least, place[axis]), Infinity));
    const high = [0, 1].map((axis) => places.reduce((most, place) => Math.max(most, place[axis]), -Infinity));
    const width = Math.max(0, high[0] - low[0], high[1] - low[1]);
    const cell = Math.max(LEAST_CELL, width / CELLS);
    const bytes = new Uint8Array(RECORD * names.length);
    const shorts = new Uint16Array(bytes.buffer);
    names.forEach((robot, index) => {
        const place = division.positions[robot];
        shorts[4 * index] = place ? Math.round((place[0] - low[0]) / cell) : NONE;
        shorts[4 * index + 1] = place ? Math.round((place[1] - low[1]) / cell) : NONE;
        shorts[4 * index + 2] = slots.get(robot) ?? NONE;
        bytes[RECORD * index + 6] = NO_HEADING;
        bytes[RECORD * index + 7] = (stale.has(robot) ? STALE : 0) | (leaders.has(robot) ? LEADER : 0);
    });
    /** @type {import("./frame.js").Frame} */
    const ground = {
        view: GROUND, names: -1, teams: -1, count: names.length,
        origin: places.length ? [low[0], low[1]] : [0, 0], cell, newest: division.at / 1e6,
        bytes, shorts, words: new Uint32Array(bytes.buffer),
    };
    return {
        names: -1,
        robots: names.map((robot) => ({ robot, superior: null, role: null, skills: [], frame: null })),
        index: new Map(names.map((robot, index) => [robot, index])),
        teams: { slots: `past ${division.sequence}`, teams: division.teams },
        lost: { count: 0, robots: [] },
        ground, embedding: null, links: null,
    };
}
