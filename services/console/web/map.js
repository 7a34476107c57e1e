// The map: one canvas for robots and links, and one above it for the grid, the scale, names and the box of a selection.

import { teamColor } from "./colors.js";
import { discs, SQUARE } from "./density.js";
import { age } from "./format.js";
import { flagsOf, hasPlace, HELD, LEADER, LOST, PINNED, placeOf, PROVISIONAL, slotOf, STALE } from "./frame.js";
import { Painter } from "./gl.js";
import { MAX_LINK_ROBOTS, sendView } from "./link.js";
import { Component, h } from "./vendor/preact.js";
import { changed, now, select, state } from "./state.js";

/** @typedef {import("./frame.js").Frame} Frame */

/** Where more robots than this are in the window, it shows how many are where, and not each of them. */
const DENSITY_ABOVE = 2000;
/** Names are written for no more robots than this. */
const MAX_LABELS = 80;
/** Ages are written for no more missing robots than this. */
const MAX_AGES = 100;
/** How long the window stands still before links are asked for again, in milliseconds. */
const ASK_AFTER = 250;
/** A click this close to a robot means it, in pixels. */
const REACH = 14;

/** What the filter by state asks for. @type {Record<string, number>} */
export const STATES = {
    stale: STALE, lost: LOST, pinned: PINNED, provisional: PROVISIONAL, leader: LEADER, held: HELD,
};

/** What is shown: the middle in metres, and pixels per metre. */
const view = { x: 0, y: 0, zoom: 1, fitted: false };
/** @type {Painter | null} */
let painter = null;
/** @type {HTMLCanvasElement | null} */
let canvas = null;
/** @type {HTMLCanvasElement | null} */
let overlay = null;
/** @type {HTMLCanvasElement | null} */
let below = null;
/** @type {{from: [number, number], to: [number, number]} | null} */
let box = null;
/** The list of teams and the theme whose colours the card has. */
let painted = "";
/** How many turns were drawn, when the last hundreds were and how old they were, and how many discs of density stood for
 * the robots; the tests read it. */
/** @type {{count: number, at: number[], ages: number[], discs: number}} */
export const drawn = { count: 0, at: [], ages: [], discs: 0 };

/** What the map shows: the fleet as it is, or as it was at the moment of the past that is shown. @returns {any} */
const world = () => state.replay?.world ?? state;

/** @returns {Frame | null} */
const frameNow = () => (state.view.embedding && !state.replay ? state.embedding : world().ground);

/** @param {string} name */
function css(name) {
    const text = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    const parts = /^#(..)(..)(..)$/.exec(text);
    return /** @type {[number, number, number]} */ (parts ? parts.slice(1).map((part) => parseInt(part, 16) / 255) : [0, 0, 0]);
}

/** Whether the filter lets a robot pass. @param {import("./state.js").Robot} robot @param {string} team its team @param {number} flags */
export function passes(robot, team, flags) {
    const wanted = state.filter;
    return (!wanted.text || robot.robot.includes(wanted.text)) && (!wanted.team || (team || "none") === wanted.team) &&
        (!wanted.role || robot.role === wanted.role) && (!wanted.skill || robot.skills.includes(wanted.skill)) &&
        (!wanted.frame || (robot.frame ?? "none") === wanted.frame) && (!wanted.state || (flags & STATES[wanted.state]) !== 0);
}

/** Whether the filter lets a robot on the map pass. @param {number} index @param {number} flags */
function isWanted(index, flags) {
    const robot = world().robots[index];
    return !robot || passes(robot, teamAt(index), flags);
}

/** The coordinate frames of the positions on the ground; "none" for robots that name none. @returns {string[]} */
export function frames() {
    const { ground, robots } = state;
    if (!ground || ground.names !== state.names) return [];
    const placed = robots.filter((_, index) => index < ground.count && hasPlace(ground, index));
    return [...new Set(placed.map((one) => one.frame ?? "none"))].sort();
}

/** @param {number} index */
function teamAt(index) {
    const frame = frameNow();
    if (!frame) return "";
    const slot = slotOf(frame, index);
    return slot === 65535 ? "none" : (world().teams?.teams?.[slot]?.id ?? "");
}

/** A frame with the teams that a proposal would give. @param {Frame} frame @returns {Frame} */
function proposed(frame) {
    const { proposal, onMap } = state.whatIf;
    if (!onMap || state.replay || !proposal?.division || frame.names !== world().names) return frame;
    const bytes = frame.bytes.slice();
    const shorts = new Uint16Array(bytes.buffer);
    const slots = new Map(teamIds().map((id, slot) => [id, slot]));
    for (const { robot, to } of proposal.division.moves) {
        const index = world().index.get(robot);
        if (index !== undefined && index < frame.count) shorts[4 * index + 2] = slots.get(to) ?? 65535;
    }
    return { ...frame, bytes, shorts, words: new Uint32Array(bytes.buffer) };
}

/** The team of each slot: the live ones, and behind them those that only a shown proposal has. @returns {string[]} */
function teamIds() {
    const live = (world().teams?.teams ?? []).map((/** @type {any} */ team) => team.id);
    const { proposal, onMap } = state.whatIf;
    const others = onMap && !state.replay ? (proposal?.division?.teams ?? []).map((/** @type {any} */ team) => team.id) : [];
    return live.concat(others.filter((/** @type {string} */ id) => !live.includes(id)));
}

const isFiltered = () => Object.values(state.filter).some(Boolean);

/** @returns {Uint8Array} for each robot: 1 chosen, 2 filtered out */
function marks() {
    const frame = frameNow();
    const all = new Uint8Array(frame?.count ?? 0);
    if (!frame || frame.names !== world().names) return all;
    for (const robot of state.selected) {
        const index = world().index.get(robot);
        if (index !== undefined) all[index] = 1;
    }
    if (isFiltered()) {
        for (let index = 0; index < frame.count; index++) {
            if (!isWanted(index, flagsOf(frame, index))) all[index] |= 2;
        }
    }
    return all;
}

/** @param {number} x @param {number} y in metres @returns {[number, number]} in pixels of the page */
function toScreen(x, y) {
    const { clientWidth, clientHeight } = /** @type {HTMLCanvasElement} */ (canvas);
    return [clientWidth / 2 + (x - view.x) * view.zoom, clientHeight / 2 - (y - view.y) * view.zoom];
}

/** @param {number} x @param {number} y in pixels @returns {[number, number]} in metres */
function toGround(x, y) {
    const { clientWidth, clientHeight } = /** @type {HTMLCanvasElement} */ (canvas);
    return [view.x + (x - clientWidth / 2) / view.zoom, view.y - (y - clientHeight / 2) / view.zoom];
}

/** Shows all robots. */
export function fit() {
    const frame = frameNow();
    if (!frame || !canvas || !canvas.clientWidth) return;
    let [left, right, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
    for (let index = 0; index < frame.count; index++) {
        if (!hasPlace(frame, index)) continue;
        const [x, y] = placeOf(frame, index);
        left = Math.min(left, x);
        right = Math.max(right, x);
        low = Math.min(low, y);
        high = Math.max(high, y);
    }
    if (left > right) return;
    const least = state.view.embedding ? 0.001 : 5;
    view.x = (left + right) / 2;
    view.y = (low + high) / 2;
    view.zoom = 0.86 * Math.min(
        canvas.clientWidth / Math.max(right - left, least), canvas.clientHeight / Math.max(high - low, least));
    view.fitted = true;
    windowMoved();
}

/** @returns {Float32Array} */
function lineEnds() {
    const [links, frame] = [world().links, frameNow()];
    if (!state.view.links || !links || !frame || links.names !== frame.names) return new Float32Array();
    const ends = new Float32Array(6 * links.count);
    let length = 0;
    for (let number = 0; number < links.count; number++) {
        const from = links.words[2 * number] & 0xffffff;
        const weight = (links.words[2 * number] >>> 24) / 255;
        const to = links.words[2 * number + 1];
        if (from >= frame.count || to >= frame.count || !hasPlace(frame, from) || !hasPlace(frame, to)) continue;
        for (const end of [from, to]) {
            const [x, y] = placeOf(frame, end);
            ends.set([x - view.x, y - view.y, weight], length);
            length += 3;
        }
    }
    return ends.subarray(0, length);
}

/** The map of density; none if few enough robots are in the window. @param {Frame} frame @param {number} width @param {number} height */
function density(frame, width, height) {
    const [left, top] = toGround(0, 0);
    const pixel = 1 / (view.zoom * frame.cell);
    const corner = /** @type {[number, number]} */ ([(left - frame.origin[0]) / frame.cell, (top - frame.origin[1]) / frame.cell]);
    const made = discs(frame, marks(), corner, pixel, [width, height]);
    return made.robots > DENSITY_ABOVE ? made : null;
}

/** Draws the newest state. */
export function draw() {
    if (!canvas || !overlay || !below || !painter) return;
    const frame = frameNow();
    const ratio = devicePixelRatio;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    for (const one of [canvas, overlay, below]) {
        if (one.width !== Math.round(width * ratio) || one.height !== Math.round(height * ratio)) {
            one.width = Math.round(width * ratio);
            one.height = Math.round(height * ratio);
        }
    }
    if (!view.fitted) fit();
    const dark = document.documentElement.dataset.theme ?? "";
    const ids = teamIds();
    const key = `${world().teams?.slots} ${ids.length} ${dark}`;
    if (painted !== key) {
        painter.setTeams(ids.map(teamColor));
        painted = key;
    }
    const shown = frame && proposed(frame);
    const dense = shown && shown.count > DENSITY_ABOVE ? density(shown, width, height) : null;
    if (dense) painter.setRobots(dense.frame, dense.marks);
    else if (shown) painter.setRobots(shown, marks());
    /** @type {[number, number]} */
    const scale = [(2 * view.zoom) / width, (2 * view.zoom) / height];
    painter.paint({
        frame: dense ? dense.frame : shown,
        ends: lineEnds(),
        scale,
        shift: [0, 0],
        size: ratio * (dense ? SQUARE : 15),
        sized: dense !== null,
        alpha: 1,
        ink: css("--ink"),
        ground: css("--map"),
        middle: [view.x, view.y],
    });
    drawGrid(below, ratio);
    drawOverlay(overlay, ratio);
    if (frame && !state.replay) {
        drawn.count += 1;
        drawn.discs = dense?.frame.count ?? 0;
        drawn.at.push(performance.now());
        if (drawn.at.length > 300) drawn.at.shift();
        drawn.ages.push(now() - frame.newest);
        if (drawn.ages.length > 300) drawn.ages.shift();
    }
}

/** The width of the squares of the grid: 1, 2 or 5 times a power of ten, at least 60 pixels. */
function gridStep() {
    const least = 60 / view.zoom;
    const power = 10 ** Math.floor(Math.log10(least));
    return [1, 2, 5, 10].map((part) => part * power).find((step) => step >= least) ?? power;
}

/** @param {HTMLCanvasElement} target @param {number} ratio */
function clear(target, ratio) {
    const pen = /** @type {CanvasRenderingContext2D} */ (target.getContext("2d"));
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, target.clientWidth, target.clientHeight);
    return pen;
}

/** The image below the map; none until it has arrived. @type {HTMLImageElement | null} */
let picture = null;

/** @param {CanvasRenderingContext2D} pen */
function drawImage(pen) {
    const edges = state.hello?.image;
    if (!edges || !state.view.image || state.view.embedding) return;
    if (!picture) {
        picture = new Image();
        picture.onload = draw;
        picture.src = "image";
    }
    if (!picture.complete || !picture.naturalWidth) return;
    const [left, top] = toScreen(edges.west, edges.north);
    const [right, low] = toScreen(edges.east, edges.south);
    pen.drawImage(picture, left, top, right - left, low - top);
}

/** @param {string} name */
const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);

/** @param {HTMLCanvasElement} target @param {number} ratio */
function drawGrid(target, ratio) {
    const pen = clear(target, ratio);
    const [width, height] = [target.clientWidth, target.clientHeight];
    const step = gridStep();
    drawImage(pen);
    pen.lineWidth = 1;
    pen.strokeStyle = color("--grid");
    const [left, top] = toGround(0, 0);
    const [right, low] = toGround(width, height);
    pen.beginPath();
    for (let x = Math.ceil(left / step) * step; x < right; x += step) {
        const [at] = toScreen(x, 0);
        pen.moveTo(at, 0);
        pen.lineTo(at, height);
    }
    for (let y = Math.ceil(low / step) * step; y < top; y += step) {
        const [, at] = toScreen(0, y);
        pen.moveTo(0, at);
        pen.lineTo(width, at);
    }
    pen.stroke();
}

/** @param {HTMLCanvasElement} target @param {number} ratio */
function drawOverlay(target, ratio) {
    const pen = clear(target, ratio);
    const [width, height] = [target.clientWidth, target.clientHeight];
    const step = gridStep();
    pen.font = "12px system-ui, sans-serif";
    const unit = state.view.embedding ? "" : step >= 1000 ? " km" : " m";
    const shown = !state.view.embedding && step >= 1000 ? step / 1000 : step;
    pen.fillStyle = color("--text");
    pen.fillRect(14, height - 16, step * view.zoom, 3);
    pen.fillText(`${Number(shown.toPrecision(3))}${unit}`, 14, height - 22);
    if (!state.view.embedding) {
        pen.fillText("N", width - 24, 20);
        pen.fillRect(width - 20.5, 26, 2, 18);
        pen.beginPath();
        pen.moveTo(width - 24, 30);
        pen.lineTo(width - 19.5, 23);
        pen.lineTo(width - 15, 30);
        pen.fill();
    }
    drawLabels(pen, color("--text"), color("--warn"));
    if (box) {
        pen.strokeStyle = color("--text");
        pen.setLineDash([5, 4]);
        pen.strokeRect(box.from[0], box.from[1], box.to[0] - box.from[0], box.to[1] - box.from[1]);
        pen.setLineDash([]);
    }
}

/** @param {CanvasRenderingContext2D} pen @param {string} text @param {string} warn */
function drawLabels(pen, text, warn) {
    const frame = frameNow();
    if (!frame || frame.names !== world().names) return;
    const label = (/** @type {string} */ robot, /** @type {string} */ more) => {
        const index = world().index.get(robot);
        if (index === undefined || index >= frame.count || !hasPlace(frame, index)) return;
        const [x, y] = toScreen(...placeOf(frame, index));
        pen.fillText(more ? `${robot} ${more}` : robot, x + 10, y - 8);
    };
    pen.fillStyle = warn;
    const missing = new Set();
    for (const one of world().lost.robots.slice(0, MAX_AGES)) {
        missing.add(one.robot);
        label(one.robot, age(now() - one.last_seen));
    }
    pen.fillStyle = text;
    const named = frame.count <= MAX_LABELS ? world().robots.map((/** @type {any} */ one) => one.robot) : [...state.selected].slice(0, MAX_LABELS);
    for (const robot of named) if (!missing.has(robot)) label(robot, "");
}

/** The robot nearest to a place on the screen. @param {number} x @param {number} y */
function robotAt(x, y) {
    const frame = frameNow();
    if (!frame || frame.names !== world().names) return "";
    let best = -1;
    let least = REACH;
    for (let index = 0; index < frame.count; index++) {
        if (!hasPlace(frame, index)) continue;
        const [atX, atY] = toScreen(...placeOf(frame, index));
        const far = Math.hypot(atX - x, atY - y);
        if (far < least) [best, least] = [index, far];
    }
    return best < 0 ? "" : world().robots[best].robot;
}

/** @param {[number, number]} from @param {[number, number]} to @param {boolean} add */
function selectBox(from, to, add) {
    const frame = frameNow();
    if (!frame || frame.names !== world().names) return;
    const [left, right] = [Math.min(from[0], to[0]), Math.max(from[0], to[0])];
    const [top, low] = [Math.min(from[1], to[1]), Math.max(from[1], to[1])];
    if (!add) state.selected.clear();
    for (let index = 0; index < frame.count; index++) {
        if (!hasPlace(frame, index) || !isWanted(index, flagsOf(frame, index))) continue;
        const [x, y] = toScreen(...placeOf(frame, index));
        if (x >= left && x <= right && y >= top && y <= low) state.selected.add(world().robots[index].robot);
    }
    state.opened = state.selected.size === 1 ? [...state.selected][0] : "";
    changed();
    sendView();
}

/** The robots in the window; null if all are there, or more than links are asked for by name. @returns {string[] | null} */
function visible() {
    const frame = frameNow();
    if (!canvas || !frame || frame.names !== world().names) return null;
    const found = [];
    for (let index = 0; index < frame.count && found.length <= MAX_LINK_ROBOTS; index++) {
        if (!hasPlace(frame, index)) continue;
        const [x, y] = toScreen(...placeOf(frame, index));
        if (x >= 0 && y >= 0 && x <= canvas.clientWidth && y <= canvas.clientHeight) found.push(world().robots[index].robot);
    }
    return found.length <= MAX_LINK_ROBOTS && found.length < frame.count ? found : null;
}
state.visible = visible;

let asks = 0;

/** Asks for the links of what is visible, once the window stands still. */
function windowMoved() {
    clearTimeout(asks);
    if (state.view.links && !state.selected.size) asks = window.setTimeout(sendView, ASK_AFTER);
}

/** @param {number} factor @param {number} x @param {number} y the place that stays, in pixels */
function zoomBy(factor, x, y) {
    const before = toGround(x, y);
    view.zoom = Math.min(1e7, Math.max(1e-6, view.zoom * factor));
    const after = toGround(x, y);
    view.x += before[0] - after[0];
    view.y += before[1] - after[1];
    windowMoved();
    draw();
}

/** @param {number} x @param {number} y in pixels */
function panBy(x, y) {
    view.x -= x / view.zoom;
    view.y += y / view.zoom;
    windowMoved();
    draw();
}

/** Where a robot stands, in pixels of the map; none if it has no place. @param {string} robot */
export function screenOf(robot) {
    const [frame, index] = [frameNow(), world().index.get(robot)];
    return frame && index !== undefined && hasPlace(frame, index) ? toScreen(...placeOf(frame, index)) : null;
}

/** Shows a robot in the middle. @param {string} robot */
export function centre(robot) {
    const [frame, index] = [frameNow(), world().index.get(robot)];
    if (!frame || index === undefined || index >= frame.count || !hasPlace(frame, index)) return;
    [view.x, view.y] = placeOf(frame, index);
    draw();
}

/** @param {boolean} embedding */
export function showEmbedding(embedding) {
    if (state.view.embedding === embedding) return;
    state.view.embedding = embedding;
    state.embedding = null;
    view.fitted = false;
    sendView();
    changed();
}

/** @param {string} modality "" for none */
export function showLinks(modality) {
    state.view.links = modality;
    state.links = null;
    sendView();
    changed();
}

/** Shows a moment of the past, or the present again. @param {any} replay */
export function showReplay(replay) {
    if (!state.replay !== !replay) view.fitted = false;
    state.replay = replay;
    draw();
    changed();
}

export class MapView extends Component {
    /** @type {HTMLElement | null} */
    root = null;

    componentDidMount() {
        const root = /** @type {HTMLElement} */ (this.root);
        [below, canvas, overlay] = /** @type {HTMLCanvasElement[]} */ ([...root.querySelectorAll("canvas")]);
        this.#open();
        // A lost graphics card comes back, and everything is uploaded again.
        canvas.addEventListener("webglcontextlost", (event) => {
            event.preventDefault();
            painter = null;
        });
        canvas.addEventListener("webglcontextrestored", () => this.#open());
        new ResizeObserver(() => draw()).observe(root);
        this.#pointer(overlay);
        overlay.addEventListener("wheel", (event) => {
            event.preventDefault();
            zoomBy(Math.exp(-event.deltaY / 500), event.offsetX, event.offsetY);
        }, { passive: false });
        overlay.addEventListener("keydown", (event) => this.#key(event));
    }

    #open() {
        try {
            painter = new Painter(/** @type {HTMLCanvasElement} */ (canvas));
            painted = "";
            state.problems.delete("map");
            draw();
        } catch (error) {
            state.problems.set("map", String(error));
            changed();
        }
    }

    /** @param {HTMLCanvasElement} target */
    #pointer(target) {
        /** @type {{x: number, y: number, pans: boolean, moved: boolean} | null} */
        let down = null;
        target.addEventListener("pointerdown", (event) => {
            target.setPointerCapture(event.pointerId);
            down = { x: event.offsetX, y: event.offsetY, pans: !event.shiftKey, moved: false };
        });
        target.addEventListener("pointermove", (event) => {
            if (!down) return;
            const [x, y] = [event.offsetX - down.x, event.offsetY - down.y];
            if (!down.moved && Math.hypot(x, y) < 4) return;
            down.moved = true;
            if (down.pans) {
                panBy(x, y);
                down.x = event.offsetX;
                down.y = event.offsetY;
            } else {
                box = { from: [down.x, down.y], to: [event.offsetX, event.offsetY] };
                draw();
            }
        });
        target.addEventListener("pointerup", (event) => {
            if (down && !down.moved) {
                select(robotAt(event.offsetX, event.offsetY), event.ctrlKey || event.metaKey);
                sendView();
            } else if (box) {
                selectBox(box.from, box.to, event.ctrlKey || event.metaKey);
            }
            down = box = null;
            draw();
        });
        target.addEventListener("pointercancel", () => {
            down = box = null;
        });
    }

    /** @param {KeyboardEvent} event */
    #key(event) {
        const { clientWidth, clientHeight } = /** @type {HTMLCanvasElement} */ (canvas);
        const [x, y] = [clientWidth / 2, clientHeight / 2];
        /** @type {Record<string, () => void>} */
        const keys = {
            ArrowLeft: () => panBy(60, 0), ArrowRight: () => panBy(-60, 0),
            ArrowUp: () => panBy(0, 60), ArrowDown: () => panBy(0, -60),
            "+": () => zoomBy(1.3, x, y), "=": () => zoomBy(1.3, x, y), "-": () => zoomBy(1 / 1.3, x, y),
            f: () => { fit(); draw(); },
            n: () => this.#step(1), p: () => this.#step(-1),
            Escape: () => { select(""); sendView(); },
        };
        const act = keys[event.key];
        if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
        event.preventDefault();
        act();
    }

    /** Chooses the next robot in the order of names. @param {number} by */
    #step(by) {
        const count = world().robots.length;
        if (!count) return;
        const at = state.opened ? (world().index.get(state.opened) ?? 0) + by : 0;
        select(world().robots[((at % count) + count) % count].robot);
        centre(state.opened);
        sendView();
    }

    render() {
        const frame = frameNow();
        const count = frame?.count ?? 0;
        const label = `Map of ${count} robots. Arrows pan, plus and minus zoom, F shows all, N and P choose the next robot, ` +
            "Escape chooses none. Shift and drag selects a box.";
        return h("div", { class: "map", ref: (/** @type {HTMLElement | null} */ root) => { this.root = root; } },
            h("canvas", { class: "grid", "aria-hidden": "true" }),
            h("canvas", { class: "gl", "aria-hidden": "true" }),
            h("canvas", { class: "over", tabIndex: 0, role: "application", "aria-label": label, id: "map" }),
            state.replay && h("div", { class: "watermark", "aria-hidden": "true" }, "REPLAY"),
            state.whatIf.onMap && !state.replay && h("div", { class: "watermark", "aria-hidden": "true" }, "WHAT IF"));
    }
}
