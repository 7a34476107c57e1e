// Frames of the server as they are; core/frame.rs says what stands where. The records go to the graphics card unread.

export const HEAD = 48;
export const RECORD = 8;
export const NONE = 65535;

export const GROUND = 1;
export const EMBEDDING = 2;
export const LINKS = 3;

export const STALE = 1;
export const LOST = 2;
export const PINNED = 4;
export const PROVISIONAL = 8;
export const LEADER = 16;
export const HELD = 32;

/**
 * @typedef {object} Frame
 * @property {number} view
 * @property {number} names the list of names that indices refer to
 * @property {number} teams the list of teams that slots refer to
 * @property {number} count
 * @property {[number, number]} origin
 * @property {number} cell
 * @property {number} newest seconds since 1970 by the clock of the service
 * @property {Uint8Array} bytes the records
 * @property {Uint16Array} shorts the same: column, row, slot, heading and flags
 * @property {Uint32Array} words the same
 */

/**
 * @param {ArrayBuffer} buffer
 * @returns {Frame | null} null for one of another version
 */
export function readFrame(buffer) {
    if (buffer.byteLength < HEAD) return null;
    const data = new DataView(buffer);
    const count = data.getUint32(12, true);
    if (data.getUint8(1) !== 1 || buffer.byteLength !== HEAD + RECORD * count) return null;
    return {
        view: data.getUint8(0),
        names: data.getUint32(4, true),
        teams: data.getUint32(8, true),
        count,
        origin: [data.getFloat64(16, true), data.getFloat64(24, true)],
        cell: data.getFloat64(32, true),
        newest: data.getFloat64(40, true),
        bytes: new Uint8Array(buffer, HEAD),
        shorts: new Uint16Array(buffer, HEAD),
        words: new Uint32Array(buffer, HEAD),
    };
}

/** @param {Frame} frame @param {number} index */
export const hasPlace = (frame, index) => frame.shorts[4 * index] !== NONE;

/** @param {Frame} frame @param {number} index @returns {[number, number]} metres, or units of the embedding */
export const placeOf = (frame, index) => [
    frame.origin[0] + frame.shorts[4 * index] * frame.cell,
    frame.origin[1] + frame.shorts[4 * index + 1] * frame.cell,
];

/** @param {Frame} frame @param {number} index */
export const slotOf = (frame, index) => frame.shorts[4 * index + 2];

/** @param {Frame} frame @param {number} index */
export const flagsOf = (frame, index) => frame.bytes[8 * index + 7];
