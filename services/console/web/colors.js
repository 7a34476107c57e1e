// Colours of teams: those of Okabe and Ito, which people of every colour vision tell apart, then lighter and darker ones.

const BASE = [
    [0x56, 0xb4, 0xe9], [0xe6, 0x9f, 0x00], [0x00, 0x9e, 0x73], [0xf0, 0xe4, 0x42],
    [0x00, 0x72, 0xb2], [0xd5, 0x5e, 0x00], [0xcc, 0x79, 0xa7],
];

/** The number in a team's id; a hash of the text where it has none. @param {string} id */
function numberOf(id) {
    const digits = /(\d+)$/.exec(id);
    if (digits) return Number(digits[1]) - 1;
    let hash = 7;
    for (const letter of id) hash = (hash * 31 + letter.charCodeAt(0)) >>> 0;
    return hash;
}

/** The colour of a team, which lasts with its id. @param {string} id @returns {[number, number, number]} */
export function teamColor(id) {
    const number = numberOf(id);
    const base = BASE[((number % BASE.length) + BASE.length) % BASE.length];
    const round = Math.floor(number / BASE.length) % 3;
    const mix = (/** @type {number} */ part) =>
        round === 0 ? part : round === 1 ? Math.round(part * 0.55 + 255 * 0.45) : Math.round(part * 0.6);
    return [mix(base[0]), mix(base[1]), mix(base[2])];
}

/** @param {string} id */
export const teamStyle = (id) => `rgb(${teamColor(id).join(" ")})`;
