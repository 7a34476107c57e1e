// What an operator commands. A change is pending until the service has answered, and the page shows what the services say.

import { canCommand } from "./alerts.js";
import { confirmThen } from "./confirm.js";
import { age, clock, fixed } from "./format.js";
import { command } from "./link.js";
import { now, state } from "./state.js";
import { describe, describeNeed, WhatIf, whatIf } from "./whatif.js";
import { Component, h } from "./vendor/preact.js";

const KINDS = ["pin", "ban", "together", "apart", "lock", "reserve"];
/** Most robots of a wish. */
const MAX_ROBOTS = 64;
/** Longest id of a wish that is made of its names alone; a longer one is cut, and ends with a checksum of all of them. */
const MAX_NAMED_ID = 48;

/** The checksum FNV-1a of 64 bits. @param {string} text */
const checksum = (text) => new TextEncoder().encode(text).reduce((/** @type {bigint} */ sum, byte) =>
    BigInt.asUintN(64, (sum ^ BigInt(byte)) * 0x100000001b3n), 0xcbf29ce484222325n);

/**
 * The id of a wish out of all its names, as `muster wish` makes it: the same wish is put once, and no other takes its place.
 * @param {string} kind @param {string[]} robots @param {string | null} team
 */
export function wishId(kind, robots, team) {
    const text = [kind, ...robots, team].filter(Boolean).join("-");
    if (text.length <= MAX_NAMED_ID) return text;
    return `${text.slice(0, MAX_NAMED_ID)}-${(checksum(text) >> 32n).toString(16).padStart(8, "0")}`;
}

const fleetSize = () => `${state.robots.length} robots`;

/** Changes settings, which may be taken back. @param {string} what @param {string} service @param {any} patch */
function change(what, service, patch) {
    const present = state.settings[service] ?? {};
    const fields = Object.keys(patch);
    const isKnown = fields.every((field) => field in present);
    const before = Object.fromEntries(fields.map((field) => [field, present[field]]));
    return command(what, service, { set: patch }, isKnown ? [{ service, action: { set: before } }] : []);
}

/** Asks what a change would do. @param {() => any} patch */
const ifButton = (patch, name = "", disabled = false) => h("button", {
    type: "button", id: `if-${name}`, disabled: disabled || !canCommand(), onClick: () => whatIf(patch()),
}, "What if");

/** @param {any} event */
const valueOf = (event) => event.target.value;

class Count extends Component {
    constructor() {
        super();
        /** @type {Record<string, string>} */
        this.state = { mode: "", one: "3", from: "2", to: "6" };
    }

    render() {
        const present = state.settings.clusterer?.teams;
        const mode = this.state.mode || (typeof present === "number" ? "one" : typeof present === "object" && present ? "range" : "auto");
        const { one, from, to } = this.state;
        const wanted = mode === "auto" ? "auto" : mode === "one" ? Number(one) : { from: Number(from), to: Number(to) };
        const radio = (/** @type {string} */ value, /** @type {string} */ label) => h("label", { class: "check" },
            h("input", { type: "radio", name: "count", value, checked: mode === value, onChange: () => this.setState({ mode: value }) }), label);
        const number = (/** @type {string} */ field, /** @type {string} */ label) => h("input", {
            type: "number", min: 1, max: 1024, "aria-label": label, value: this.state[field], id: `count-${field}`,
            onInput: (/** @type {any} */ event) => this.setState({ [field]: valueOf(event) }),
        });
        return h("fieldset", {}, h("legend", {}, "Number of teams"),
            h("p", {}, "It is ", h("strong", { id: "count-now" }, describe(present)), "."),
            h("div", { class: "line" }, radio("auto", "as the relations show"), radio("one", "exactly"), radio("range", "a range")),
            mode === "one" ? number("one", "Number of teams") : null,
            mode === "range" ? h("span", {}, number("from", "Least number of teams"), " to ", number("to", "Largest number of teams")) : null,
            h("button", { type: "button", id: "count-set", disabled: !canCommand(), onClick: () =>
                confirmThen(`Divide ${fleetSize()} into ${describe(wanted)} teams? It is ${describe(present)} at present.`, () =>
                    change(`teams = ${describe(wanted)}`, "clusterer", { teams: wanted })) }, "Set number of teams"), " ",
            ifButton(() => ({ teams: wanted }), "count"));
    }
}

/** The weights that are set, or those that the embedder has chosen, before its trust in them. @returns {Record<string, number> | null} */
function weightsNow() {
    const set = state.settings.embedder?.weights;
    if (!set) return null;
    if (Object.keys(set).length) return set;
    const used = (state.fleet?.weights ?? []).map((/** @type {any} */ one) =>
        [one.modality, one.trust > 0 ? one.weight / one.trust : one.weight]);
    const sum = used.reduce((/** @type {number} */ all, /** @type {any} */ one) => all + one[1], 0);
    if (!(sum > 0)) return null;
    return Object.fromEntries(used.map((/** @type {any} */ [name, weight]) => [name, weight / sum]));
}

/** Weights as people write them. Rounding must not change their sum, which is 1. @param {Record<string, number>} weights */
function rounded(weights) {
    const wanted = Object.fromEntries(Object.entries(weights).map(([name, weight]) => [name, Number(weight.toFixed(4))]));
    const [first] = Object.keys(wanted);
    const others = Object.entries(wanted).filter(([name]) => name !== first).reduce((all, [, weight]) => all + weight, 0);
    wanted[first] = Number((1 - others).toFixed(4));
    return wanted;
}

class Weights extends Component {
    constructor() {
        super();
        /** @type {{weights: Record<string, number> | null}} */
        this.state = { weights: null };
    }

    /** Moves one slider; the others give or take what keeps the sum. @param {Record<string, number>} weights @param {string} name @param {number} value */
    #move(weights, name, value) {
        const sum = Object.values(weights).reduce((all, one) => all + one, 0);
        const wanted = Math.min(sum, Math.max(0, value));
        const others = Object.keys(weights).filter((other) => other !== name);
        const rest = others.reduce((all, other) => all + weights[other], 0);
        const next = { ...weights, [name]: wanted };
        for (const other of others) {
            next[other] = rest > 0 ? (weights[other] / rest) * (sum - wanted) : (sum - wanted) / others.length;
        }
        this.setState({ weights: next });
    }

    render() {
        const present = weightsNow();
        if (!present) return null;
        const weights = this.state.weights ?? present;
        const sum = Object.values(/** @type {Record<string, number>} */ (weights)).reduce((all, one) => all + one, 0);
        return h("fieldset", {}, h("legend", {}, "Weights of the modalities"),
            Object.keys(weights).map((name) => h("label", { key: name, class: "slider" },
                h("span", {}, name),
                h("input", { type: "range", min: 0, max: sum, step: sum / 200, value: weights[name], id: `weight-${name}`,
                    onInput: (/** @type {any} */ event) => this.#move(weights, name, Number(valueOf(event))) }),
                h("output", {}, fixed(weights[name]), weights[name] !== present[name] ? ` (is ${fixed(present[name])})` : ""))),
            h("div", { class: "line" },
                h("button", { type: "button", id: "weights-set", disabled: !canCommand() || !this.state.weights, onClick: () =>
                    confirmThen(`Change the weights of the modalities for ${fleetSize()}?`, () => {
                        void change("weights", "embedder", { weights: rounded(weights) });
                        this.setState({ weights: null });
                    }) }, "Set weights"),
                ifButton(() => ({ weights: rounded(weights) }), "weights", !this.state.weights),
                h("button", { type: "button", disabled: !this.state.weights, onClick: () => this.setState({ weights: null }) }, "Reset")));
    }
}

class Limits extends Component {
    constructor() {
        super();
        /** @type {Record<string, string>} */
        this.state = { team: "", min: "", max: "" };
    }

    render() {
        const { size, team_size: own } = state.settings.clusterer ?? {};
        const { team, min, max } = this.state;
        const shown = (/** @type {any} */ one) => `${one?.min ?? "–"} to ${one?.max ?? "–"}`;
        const field = (/** @type {string} */ name, /** @type {string} */ label) => h("label", {}, label, h("input", {
            type: "number", min: 1, value: this.state[name], id: `limit-${name}`,
            onInput: (/** @type {any} */ event) => this.setState({ [name]: valueOf(event) }) }));
        const number = (/** @type {string} */ text) => (text ? Number(text) : null);
        const wanted = { min: number(min), max: number(max) };
        const patch = () => {
            const sizes = { ...own };
            if (wanted.min === null && wanted.max === null) delete sizes[team];
            else sizes[team] = wanted;
            return team ? { team_size: sizes } : { size: wanted };
        };
        const set = () => {
            const whom = team || "every team";
            confirmThen(`Let ${whom} have ${shown(wanted)} robots?`, () =>
                change(`size of ${whom} = ${shown(wanted)}`, "clusterer", patch()));
        };
        return h("fieldset", {}, h("legend", {}, "Limits of teams"),
            h("p", { id: "limits-now" }, `Every team: ${shown(size)} robots`,
                Object.entries(own ?? {}).map(([id, one]) => `; ${id}: ${shown(one)}`)),
            h("div", { class: "line" },
                h("label", {}, "Team", h("select", { id: "limit-team", value: team, onChange: (/** @type {any} */ event) => this.setState({ team: valueOf(event) }) },
                    h("option", { value: "" }, "every team"),
                    (state.teams?.teams ?? []).map((/** @type {any} */ one) => h("option", { value: one.id }, one.id)))),
                field("min", "At least"), field("max", "At most"),
                h("button", { type: "button", id: "limits-set", disabled: !canCommand(), onClick: set }, "Set limits"),
                ifButton(patch, "limits")));
    }
}

class Needs extends Component {
    constructor() {
        super();
        this.state = { skill: "", min: "1", team: "", soft: false };
    }

    render() {
        const needs = state.settings.clusterer?.needs ?? [];
        const { skill, min, team, soft } = this.state;
        const need = { skill, per_team: { min: Number(min) }, ...(team ? { team } : {}), ...(soft ? { soft } : {}) };
        const put = (/** @type {any[]} */ wanted, /** @type {string} */ what) => confirmThen(`${what}?`, () =>
            change(what, "clusterer", { needs: wanted }));
        return h("fieldset", {}, h("legend", {}, "Needs of skills"),
            h("ul", { id: "needs" }, needs.map((/** @type {any} */ need, /** @type {number} */ number) => h("li", { key: number },
                describeNeed(need), " ",
                h("button", { type: "button", disabled: !canCommand(), "aria-label": `Remove ${describeNeed(need)}`, onClick: () =>
                    put(needs.filter((/** @type {any} */ _, /** @type {number} */ other) => other !== number), `Remove the need ${describeNeed(need)}`) }, "Remove")))),
            h("div", { class: "line" },
                h("label", {}, "Skill", h("input", { value: skill, id: "need-skill", pattern: "[a-z0-9_\\-]+",
                    onInput: (/** @type {any} */ event) => this.setState({ skill: valueOf(event) }) })),
                h("label", {}, "At least", h("input", { type: "number", min: 0, value: min, id: "need-min",
                    onInput: (/** @type {any} */ event) => this.setState({ min: valueOf(event) }) })),
                h("label", {}, "Team", h("select", { id: "need-team", value: team, onChange: (/** @type {any} */ event) => this.setState({ team: valueOf(event) }) },
                    h("option", { value: "" }, "every team"),
                    (state.teams?.teams ?? []).map((/** @type {any} */ one) => h("option", { value: one.id }, one.id)))),
                h("label", { class: "check" }, h("input", { type: "checkbox", id: "need-soft", checked: soft,
                    onChange: (/** @type {any} */ event) => this.setState({ soft: event.target.checked }) }), "where possible"),
                h("button", { type: "button", id: "need-add", disabled: !canCommand() || !skill, onClick: () =>
                    put([...needs, need], `Add the need ${describeNeed(need)}`) }, "Add need"),
                ifButton(() => ({ needs: [...needs, need] }), "needs", !skill)));
    }
}

class Wishes extends Component {
    constructor() {
        super();
        this.state = { kind: "pin", team: "", note: "", minutes: "" };
    }

    #put() {
        const { kind, team, note, minutes } = this.state;
        const robots = kind === "lock" ? [] : [...state.selected].sort();
        const where = ["pin", "ban", "lock"].includes(kind) ? (team || state.teams?.teams?.[0]?.id) : null;
        const wish = { kind, robots, ...(where ? { team: where } : {}), ...(note ? { note } : {}),
            ...(minutes ? { expires: now() + 60 * Number(minutes) } : {}) };
        const id = wishId(kind, robots, where);
        const go = () => command(`${kind} ${robots.join(" ")} ${where ?? ""}`, "clusterer", { wish: { id, wish } }, [{ service: "clusterer", action: { withdraw: { id } } }]);
        // What holds a whole team, or takes robots out of the fleet, is asked twice.
        if (kind === "lock" || kind === "reserve" || robots.length > 1) confirmThen(`${kind} ${robots.join(", ")} ${where ?? ""}?`, go);
        else void go();
    }

    render() {
        const { kind, team, note, minutes } = this.state;
        const hasTeam = ["pin", "ban", "lock"].includes(kind);
        const chosen = state.selected.size;
        const least = kind === "lock" ? 0 : kind === "together" || kind === "apart" ? 2 : 1;
        const fits = kind === "lock" || (chosen >= least && chosen <= MAX_ROBOTS);
        const own = state.hello?.operator;
        return h("fieldset", {}, h("legend", {}, "Wishes"),
            h("p", {}, kind === "lock" ? "Of a whole team." : chosen ? `Of what is selected: ${[...state.selected].slice(0, 6).join(", ")}${chosen > 6 ? `, … (${chosen})` : ""}` : "Select robots on the map."),
            h("div", { class: "line" },
                h("label", {}, "Wish", h("select", { id: "wish-kind", value: kind, onChange: (/** @type {any} */ event) => this.setState({ kind: valueOf(event) }) },
                    KINDS.map((one) => h("option", { value: one, selected: one === kind }, one)))),
                hasTeam ? h("label", {}, "Team", h("select", { id: "wish-team", value: team || state.teams?.teams?.[0]?.id, onChange: (/** @type {any} */ event) => this.setState({ team: valueOf(event) }) },
                    (state.teams?.teams ?? []).map((/** @type {any} */ one) => h("option", { value: one.id, selected: one.id === team }, one.id)))) : null,
                h("label", {}, "Minutes", h("input", { type: "number", id: "wish-minutes", min: 1, value: minutes, placeholder: "no end",
                    onInput: (/** @type {any} */ event) => this.setState({ minutes: valueOf(event) }) })),
                h("label", {}, "Note", h("input", { id: "wish-note", value: note, maxLength: 256, onInput: (/** @type {any} */ event) => this.setState({ note: valueOf(event) }) })),
                h("button", { type: "button", id: "wish-put", disabled: !canCommand() || !fits, onClick: () => this.#put() }, "Wish")),
            h("ul", { id: "wishes" }, state.wishes.map((one) => h("li", { key: `${one.operator}/${one.id}`, "data-wish": one.id, "data-state": one.state },
                h("strong", {}, one.wish.kind), ` ${one.wish.robots.join(" ")} ${one.wish.team ?? ""}: ${one.state}`,
                one.reason ? ` (${one.reason})` : "", h("span", { class: "dim" }, ` ${one.operator}/${one.id}`,
                    one.wish.expires ? ` for ${age(one.wish.expires - now())}` : "", one.wish.note ? ` “${one.wish.note}”` : ""), " ",
                one.operator === own ? h("button", { type: "button", disabled: !canCommand(), "aria-label": `Withdraw ${one.id}`, onClick: () =>
                    confirmThen(`Withdraw ${one.id}?`, () => command(`withdraw ${one.id}`, "clusterer", { withdraw: { id: one.id } }, [{ service: "clusterer", action: { wish: { id: one.id, wish: one.wish } } }])) }, "Withdraw") : null))));
    }
}

/** @param {import("./state.js").Order} order */
async function takeBack(order) {
    const steps = order.undo;
    order.undo = [];
    for (const { service, action } of steps) await command(`undo ${order.what}`, service, action);
}

function orders() {
    return h("section", { "aria-labelledby": "orders-title" },
        h("h2", { id: "orders-title" }, "Commands of this page"),
        h("ol", { id: "orders", "aria-live": "polite" }, state.orders.map((one) => h("li", { key: one.id, "data-order": one.state, class: one.reason ? "warn" : "" },
            h("span", { class: "dim" }, `${clock(one.at)} `), `${one.what}: `, h("strong", {}, one.state),
            one.reason ? ` – ${one.reason}` : "", one.state === "unknown" ? "; what the services say now is shown above" : "", " ",
            one.state === "done" && one.undo.length ? h("button", { type: "button", disabled: !canCommand(), "aria-label": `Undo ${one.what}`, onClick: () =>
                confirmThen(`Undo ${one.what}?`, () => void takeBack(one)) }, "Undo") : null))));
}

export function Control() {
    if (state.hello?.role === "viewer") return h("p", { id: "viewer" }, "You are a viewer: you see everything and command nothing.");
    return h("div", {},
        canCommand() ? null : h("p", { class: "warn" }, state.replay ? "The past is shown; nothing can be commanded." : "There is no link: nothing can be commanded."),
        h(Count, {}), h(Weights, {}), h(Limits, {}), h(Needs, {}), h(WhatIf, {}), h(Wishes, {}), orders());
}
