// Numbers and times as people read them.

/** @param {number | null | undefined} value @param {number} digits */
export const fixed = (value, digits = 2) =>
    value === null || value === undefined || Number.isNaN(value) ? "–" : value.toFixed(digits);

/** An age. @param {number | null | undefined} seconds */
export function age(seconds) {
    if (seconds === null || seconds === undefined || Number.isNaN(seconds)) return "–";
    const whole = Math.max(0, seconds);
    if (whole < 1) return `${Math.round(whole * 1000)} ms`;
    if (whole < 90) return `${whole < 10 ? whole.toFixed(1) : Math.round(whole)} s`;
    if (whole < 5400) return `${Math.round(whole / 60)} min`;
    return `${(whole / 3600).toFixed(1)} h`;
}

/** A moment by the clock of the fleet, in the time zone of the reader. @param {number} seconds */
export const clock = (seconds) => new Date(seconds * 1000).toLocaleTimeString([], { hour12: false });

/** @param {number} seconds */
export const moment = (seconds) => {
    const date = new Date(seconds * 1000);
    return `${date.toLocaleDateString()} ${date.toLocaleTimeString([], { hour12: false })}`;
};

/** @param {number} count @param {string} noun */
export const counted = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;

/** @param {string} word as `cut_off` */
export const words = (word) => word.replaceAll("_", " ");
