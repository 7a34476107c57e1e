// What the page knows. All of it came from the server; the page invents nothing, and no clock of this computer is read.

import { EMBEDDING, GROUND, LINKS, readFrame } from "./frame.js";

/** @typedef {import("./frame.js").Frame} Frame */
/**
 * @typedef {object} Robot
 * @property {string} robot
 * @property {string | null} superior
 * @property {string | null} role
 * @property {string[]} skills
 * @property {string | null} frame
 */
/**
 * @typedef {object} Order a command of this page
 * @property {number} id
 * @property {string} what
 * @property {"pending" | "done" | "refused" | "unknown"} state
 * @property {string} reason why; with one that is done, a warning
 * @property {{service: string, action: any}[]} undo what takes it back, in this order; none where nothing does
 * @property {number} at
 */

/**
 * @typedef {object} WhatIf
 * @property {Record<string, any>} asked what is to be different
 * @property {any} proposal what came of it
 * @property {number} at when it came
 * @property {string} problem
 * @property {boolean} isAsking
 * @property {boolean} onMap whether the map shows it
 */

/** Events that are kept. */
const MAX_EVENTS = 500;
/** Samples that charts show: ten minutes. */
const MAX_SAMPLES = 600;
/** Commands that are listed. */
const MAX_ORDERS = 50;

export const state = {
    /** @type {"closed" | "open" | "sign-in"} */
    socket: "closed",
    link: false,
    /** whether somebody signed in by a token */ byToken: false,
    /** @type {any} */ hello: null,
    /** @type {any} */ fleet: null,
    /** @type {any} */ teams: null,
    /** @type {any} */ audit: null,
    /** @type {any} */ alerts: null,
    /** @type {any[]} */ wishes: [],
    /** @type {any} */ services: null,
    /** @type {any} */ before: null,
    /** @type {any} */ settings: {},
    /** @type {any} */ lost: { count: 0, robots: [] },
    /** @type {any[]} */ events: [],
    /** @type {Robot[]} */ robots: [],
    /** @type {Map<string, number>} */ index: new Map(),
    names: 0,
    /** @type {Robot[]} the list that arrives */ coming: [],
    comingNames: 0,
    /** @type {Frame | null} */ ground: null,
    /** @type {Frame | null} */ embedding: null,
    /** @type {Frame | null} */ links: null,
    /** @type {Order[]} */ orders: [],
    /** @type {number[][]} moment, then the lines of the charts */
    samples: [[], [], [], [], []],
    /** @type {Map<string, number[]>} latency of each stage, in milliseconds */ stages: new Map(),
    /** @type {Map<string, string>} what is wrong, by its topic */ problems: new Map(),
    serverNow: 0,
    serverNowAt: 0,
    /** @type {Set<string>} */ selected: new Set(),
    /** @type {string} the robot in the drawer */ opened: "",
    /** the panel on the right */ panel: "Teams",
    /** @type {() => string[] | null} the robots in the window of the map; null if that is all or too many */ visible: () => null,
    view: { embedding: false, /** @type {string} */ links: "", image: true },
    filter: { text: "", team: "", role: "", skill: "", frame: "", state: "" },
    /** @type {any} a moment of the past that is shown */ replay: null,
    /** @type {WhatIf} */ whatIf: { asked: {}, proposal: null, at: 0, problem: "", isAsking: false, onMap: false },
};

/** @type {Set<() => void>} */
const listeners = new Set();
let isScheduled = false;

/** @param {() => void} listener */
export const subscribe = (listener) => {
    listeners.add(listener);
};

/** Panels are drawn again a few times a second, whatever arrives; a table of thousands of cells takes longer than a frame. */
export function changed() {
    if (isScheduled) return;
    isScheduled = true;
    setTimeout(() => {
        isScheduled = false;
        for (const listener of listeners) listener();
    }, 100);
}

/** The clock of the console's host, in seconds since 1970. */
export const now = () => state.serverNow + (performance.now() - state.serverNowAt) / 1000;

/** @param {ArrayBuffer} buffer */
export function receiveFrame(buffer) {
    const frame = readFrame(buffer);
    if (!frame) return;
    if (frame.view === GROUND) state.ground = frame;
    else if (frame.view === EMBEDDING) state.embedding = frame;
    else if (frame.view === LINKS) state.links = frame;
}

/** @param {any} data a piece of the names */
function receiveNames(data) {
    if (data.from === 0) {
        state.coming = [];
        state.comingNames = data.names;
    }
    if (state.comingNames !== data.names) return;
    for (const [robot, superior, role, skills, frame] of data.robots) {
        state.coming.push({
            robot, superior: superior ?? null, role: role ?? null, skills: skills ?? [], frame: frame ?? null,
        });
    }
    if (state.coming.length >= data.of) {
        state.robots = state.coming;
        state.names = data.names;
        state.index = new Map(state.robots.map((one, number) => [one.robot, number]));
        state.coming = [];
    }
}

/** An audit that came in this turn: its moment comes with the end of the turn. @type {any} */
let unsampled = null;

/** @param {any} audit */
function sample(audit) {
    const at = now();
    const last = state.samples[0].at(-1) ?? 0;
    if (at - last < 0.9) return;
    const values = [
        at, audit.silhouette?.mean ?? null, audit.physical?.mean ?? null,
        audit.flapping?.returns_per_robot_minute ?? null, audit.data_age_s ?? null,
    ];
    values.forEach((value, line) => state.samples[line].push(value));
    const length = state.samples[0].length;
    const stages = new Map((audit.stages ?? []).map((/** @type {any} */ stage) =>
        [stage.stage, 1000 * (stage.published - stage.received)]));
    for (const name of stages.keys()) {
        if (!state.stages.has(name)) state.stages.set(name, Array(length - 1).fill(null));
    }
    for (const [name, line] of state.stages) line.push(stages.get(name) ?? null);
    if (length > MAX_SAMPLES) {
        for (const line of state.samples) line.shift();
        for (const line of state.stages.values()) line.shift();
    }
}

/** @param {any} message @returns {number} the turn that ends with it; 0 for others */
export function receive(message) {
    const { topic, data, problem } = message;
    // A message of a topic that can be shown again ends its problem.
    if (problem) state.problems.set(topic, problem);
    else state.problems.delete(topic);
    switch (topic) {
        case "hello":
            state.hello = data;
            // Another console, or another version of it, may read what this page sends.
            state.problems.delete("problem");
            break;
        case "fleet": state.fleet = data; break;
        case "teams": state.teams = data; break;
        case "audit":
            state.audit = data;
            unsampled = data;
            break;
        case "alerts": state.alerts = data; break;
        case "wishes": state.wishes = data ?? []; break;
        case "services":
            state.before = state.services;
            state.services = data;
            break;
        case "settings": state.settings = data ?? {}; break;
        case "lost": state.lost = data ?? { count: 0, robots: [] }; break;
        case "events":
            state.events = state.events.concat(data ?? []).slice(-MAX_EVENTS);
            break;
        case "names": receiveNames(data); break;
        case "problem": state.problems.set(topic, String(data)); break;
        case "end":
            state.serverNow = data.now;
            state.serverNowAt = performance.now();
            state.link = data.link;
            if (unsampled) sample(unsampled);
            unsampled = null;
            return data.turn;
    }
    return 0;
}

/** @param {Order} order */
export function addOrder(order) {
    state.orders = [order, ...state.orders].slice(0, MAX_ORDERS);
    changed();
}

/** The id of the team of a robot; "" without one. @param {number} index */
export function teamOf(index) {
    const frame = state.ground;
    if (!frame || index < 0 || index >= frame.count) return "";
    return state.teams?.teams?.[frame.shorts[4 * index + 2]]?.id ?? "";
}

/** @param {string} robot @param {boolean} add */
export function select(robot, add = false) {
    if (!add) state.selected.clear();
    if (robot) {
        if (add && state.selected.has(robot)) state.selected.delete(robot);
        else state.selected.add(robot);
    }
    state.opened = state.selected.size === 1 ? [...state.selected][0] : "";
    changed();
}
