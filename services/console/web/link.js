// The WebSocket: it opens again by itself, gives a credit for each turn that was drawn, and knows what came of commands.

import { addOrder, changed, now, receive, receiveFrame, state } from "./state.js";

/** Between two attempts to open, in milliseconds. */
const FIRST_WAIT = 250;
const LONGEST_WAIT = 2000;
/** Most robots whose links are asked for by name. */
export const MAX_LINK_ROBOTS = 400;
/** A hidden page is not drawn; it is kept up to date this often all the same. */
const HIDDEN_DRAW = 1000;

/**
 * What may have come of what has no answer: nothing, nothing for now, it holds and a restart may forget it, or no one knows.
 * @typedef {"refused" | "unavailable" | "unstored" | "unknown"} Kind
 */
/** @type {Kind[]} */
const KINDS = ["refused", "unavailable", "unstored", "unknown"];
/** How a command is shown of which that is known. @type {Record<Kind, "done" | "refused" | "unknown">} */
const STATES = { refused: "refused", unavailable: "refused", unstored: "done", unknown: "unknown" };

/** Why there is no answer. */
class Problem extends Error {
    /** @param {Kind} kind @param {string} reason */
    constructor(kind, reason) {
        super(reason);
        this.kind = kind;
    }
}

/** @type {WebSocket | null} */
let socket = null;
let wait = FIRST_WAIT;
let next = 1;
/** @type {() => void} */
let draw = () => {};
/** @type {Map<number, {resolve: (answer: any) => void, reject: (reason: Error) => void, isCommand: boolean}>} */
const open = new Map();

/** @param {() => void} drawer */
export function connect(drawer) {
    draw = drawer;
    void reconnect();
}

async function reconnect() {
    try {
        const answer = await fetch("/session");
        if (answer.status === 401) {
            state.socket = "sign-in";
            changed();
            return;
        }
        state.byToken = (await answer.json()).token === true;
    } catch {
        return again();
    }
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    socket = new WebSocket(`${scheme}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
        wait = FIRST_WAIT;
        state.socket = "open";
        // The server begins with nothing; what is shown until then is what was last known.
        state.events = [];
        sendView();
        changed();
    };
    socket.onmessage = ({ data }) => {
        if (typeof data !== "string") return receiveFrame(data);
        const message = JSON.parse(data);
        if (message.topic === "reply") return settle(message.data);
        const turn = receive(message);
        if (turn) drawThen(turn);
    };
    socket.onclose = () => {
        state.socket = "closed";
        state.link = false;
        // No one knows whether these were carried out. What the services say after the next start decides.
        for (const { reject } of open.values()) reject(new Problem("unknown", "the console was lost before an answer came"));
        open.clear();
        changed();
        again();
    };
}

function again() {
    state.socket = "closed";
    setTimeout(() => void reconnect(), wait);
    wait = Math.min(2 * wait, LONGEST_WAIT);
}

/** @param {number} turn */
function drawThen(turn) {
    const drawn = () => {
        draw();
        send({ credit: turn });
    };
    changed();
    if (document.hidden) setTimeout(drawn, HIDDEN_DRAW);
    else requestAnimationFrame(drawn);
}

/** @param {any} message */
function send(message) {
    const isOpen = socket?.readyState === WebSocket.OPEN;
    if (isOpen) socket?.send(JSON.stringify(message));
    return isOpen;
}

/** Tells the server what is shown. */
export function sendView() {
    const { embedding, links } = state.view;
    const chosen = state.selected.size ? [...state.selected] : state.visible();
    const robots = (chosen ?? []).slice(0, MAX_LINK_ROBOTS);
    // Where no one is visible there is nothing to show.
    const isShown = links && chosen?.length !== 0;
    send({ view: { embedding, links: isShown ? { modality: links, robots } : null } });
}

/** @param {any} reply */
function settle(reply) {
    const waiting = open.get(reply.id);
    open.delete(reply.id);
    const kind = KINDS.find((one) => reply[one] !== undefined);
    if (kind) waiting?.reject(new Problem(kind, reply[kind]));
    else waiting?.resolve(reply.answer);
}

/** @param {string} kind @param {any} content @param {boolean} isCommand @returns {Promise<any>} */
function request(kind, content, isCommand) {
    const id = next++;
    return new Promise((resolve, reject) => {
        open.set(id, { resolve, reject, isCommand });
        if (!send({ [kind]: { id, ...content } })) {
            open.delete(id);
            reject(new Problem("refused", "the console is not reached; nothing was sent"));
        }
    });
}

/** @param {any} content @returns {Promise<any>} */
export const ask = (content) => request("ask", content, false);

/** Asks for a proposal, or decides on one. @param {string} name @param {any} step @returns {Promise<any>} */
export const propose = (name, step) => request("propose", { name, step }, step === "accept");

/**
 * Has something carried out that changes the fleet. It is pending until the service has answered; the page shows what the
 * services say then.
 * @param {string} what in words
 * @param {() => Promise<any>} send
 * @param {(answer: any) => {service: string, action: any}[]} undo what takes it back; it is given no answer where that could
 * not be stored or is too long
 */
export async function carryOut(what, send, undo) {
    /** @type {import("./state.js").Order} */
    const order = { id: next, what, state: "pending", reason: "", undo: [], at: now() };
    addOrder(order);
    try {
        const answer = await send();
        order.state = "done";
        order.undo = undo(answer);
    } catch (error) {
        // Whatever else goes wrong does so before anything is sent.
        order.state = error instanceof Problem ? STATES[error.kind] : "refused";
        order.reason = error instanceof Error ? error.message : String(error);
        if (order.state === "done") order.undo = undo(null);
    }
    changed();
    return order;
}

/**
 * Commands a service.
 * @param {string} what in words @param {string} service @param {any} action
 * @param {{service: string, action: any}[]} [undo] what takes it back
 */
export const command = (what, service, action, undo = []) =>
    carryOut(what, () => request("command", { service, action }, true), () => undo);

/** @param {string} token @returns {Promise<string>} what is wrong; "" if nothing is */
export async function signIn(token) {
    try {
        const answer = await fetch("/session", { method: "POST", body: JSON.stringify({ token }) });
        if (!answer.ok) return (await answer.json().catch(() => ({}))).problem ?? "the console refuses the token";
    } catch {
        return "the console is not reached";
    }
    void reconnect();
    return "";
}

export async function signOut() {
    await fetch("/session", { method: "DELETE" });
    location.reload();
}
