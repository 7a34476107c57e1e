// What if: what the fleet would be with other settings, or without some robots. Nothing of it changes until it is accepted.

import { canCommand } from "./alerts.js";
import { confirmThen } from "./confirm.js";
import { age, counted, fixed } from "./format.js";
import { carryOut, propose } from "./link.js";
import { draw } from "./map.js";
import { robotLink, teamName } from "./teams.js";
import { changed, now, state } from "./state.js";
import { h } from "./vendor/preact.js";

/** Most robots that a proposal leaves out. */
const MAX_WITHOUT = 64;
/** Who would move is listed up to this number. */
const MAX_LISTED = 100;

/** The name of the proposal of this page: another page of the same operator has one of its own. */
const NAME = `page-${crypto.getRandomValues(new Uint32Array(2)).join("-")}`;

/** A number of teams. @param {any} teams the setting */
export function describe(teams) {
    if (teams === undefined) return "unknown";
    if (teams === "auto") return "auto";
    return typeof teams === "number" ? `${teams}` : `${teams.from} to ${teams.to}`;
}

/** @param {any} need */
export const describeNeed = (need) =>
    `${need.team ?? "every team"}: ${need.skill}, at least ${need.per_team?.min ?? 0}` +
    `${need.per_team?.max ? `, at most ${need.per_team.max}` : ""}${need.soft ? ", where possible" : ""}`;

/** @param {any} size */
const describeSize = (size) => `${size.min ?? "–"} to ${size.max ?? "–"}`;

/** What is asked for in words, by its field. @type {Record<string, (value: any) => string>} */
const WORDS = {
    teams: (value) => `${describe(value)} teams`,
    weights: (value) => Object.entries(value).map(([name, weight]) => `${name} ${fixed(weight)}`).join(", "),
    size: (value) => `every team has ${describeSize(value)} robots`,
    team_size: (value) => Object.entries(value).map(([team, size]) => `${team} has ${describeSize(size)} robots`).join(", ") || "no limits of single teams",
    needs: (value) => value.map(describeNeed).join("; ") || "no needs",
    without: (value) => `without ${value.slice(0, 6).join(" ")}${value.length > 6 ? ` … (${value.length})` : ""}`,
};

/** Grows with every question, so that the answer to an older one is not shown. */
let round = 0;

/** Adds to what is asked for, and asks. @param {any} patch */
export function whatIf(patch) {
    Object.assign(state.whatIf.asked, patch);
    void ask();
}

async function ask() {
    const own = ++round;
    const one = state.whatIf;
    Object.assign(one, { proposal: null, problem: "", isAsking: true });
    changed();
    try {
        let answer = await propose(NAME, { ask: one.asked });
        while (own === round && answer.state === "computing") answer = await propose(NAME, "show");
        if (own === round) Object.assign(one, { proposal: answer, at: now() });
    } catch (error) {
        if (own === round) one.problem = error instanceof Error ? error.message : String(error);
    }
    if (own !== round) return;
    one.isAsking = false;
    changed();
    draw();
}

function clear() {
    round++;
    Object.assign(state.whatIf, { asked: {}, proposal: null, problem: "", isAsking: false, onMap: false });
    changed();
    draw();
}

function reject() {
    // The planner forgets it by itself as well.
    if (state.whatIf.proposal) propose(NAME, "drop").catch(() => {});
    clear();
}

/** The parts of a proposal as they are applied, where the list of them did not come. @param {any} proposal */
const partsOf = ({ id, asked, division }) => [
    ...(asked.without?.length ? [{ service: "clusterer", reserve: { id: `propose-${id}` } }] : []),
    ...Object.keys(division.replaces).map((service) => ({ service, set: {} })),
];

/**
 * What takes an accepted proposal back: its parts, the last one first.
 * @param {any} proposal @param {any[] | null} applied the parts; null if they did not come
 */
export const undoOf = (proposal, applied) => (applied ?? partsOf(proposal)).map((part) =>
    part.set ? { service: part.service, action: { set: proposal.division.replaces[part.service] } }
        : { service: part.service, action: { withdraw: { id: part.reserve.id } } }).reverse();

/** @param {any} proposal */
function accept(proposal) {
    confirmThen(`Make the fleet this? ${counted(proposal.division.moved, "robot")} would move.`, async () => {
        const what = `proposal: ${Object.entries(state.whatIf.asked).map(([field, value]) => WORDS[field](value)).join("; ")}`;
        const order = await carryOut(what, () => propose(NAME, "accept"), (applied) => undoOf(proposal, applied));
        if (order.state === "done") clear();
    });
}

/** @param {number | null} value */
const signed = (value) => (value === null ? "–" : `${value > 0 ? "+" : ""}${fixed(value, 3)}`);

/** @param {any} division */
function quality(division) {
    const rows = [["mean fit of robots", "mean"], ["least mean fit of a team", "least_team"], ["mean fit by position", "physical_mean"]];
    return h("table", { id: "if-quality" },
        h("caption", {}, "Fit (silhouette, -1 to 1) among the same vectors and robots"),
        h("thead", {}, h("tr", {}, ["fit", "now", "proposed", "change"].map((name) => h("th", { scope: "col" }, name)))),
        h("tbody", {}, rows.map(([words, field]) => h("tr", { key: field },
            h("th", { scope: "row" }, words),
            h("td", { class: "number" }, fixed(division.live[field], 3)),
            h("td", { class: "number" }, fixed(division.proposed[field], 3)),
            h("td", { class: `number ${division.change[field] < 0 ? "warn" : ""}` }, signed(division.change[field]))))));
}

/** The live teams next to the proposed ones. @param {any} division */
function teams(division) {
    const of = (/** @type {any[]} */ list) => new Map(list.map((one) => [one.id, one]));
    const [live, proposed] = [of(division.live_teams), of(division.teams)];
    const all = [...new Set([...live.keys(), ...proposed.keys()])].sort();
    const cells = (/** @type {any} */ one) => [
        h("td", { class: "number" }, one?.robots ?? "–"),
        h("td", { class: "number" }, fixed(one?.mean)),
        h("td", { class: "number" }, fixed(one?.least))];
    return h("table", { id: "if-teams" },
        h("caption", {}, "The present division and the proposed one"),
        h("thead", {},
            h("tr", {}, h("th", { scope: "col", rowSpan: 2 }, "team"),
                ["now", "proposed"].map((name) => h("th", { scope: "colgroup", colSpan: 3 }, name))),
            h("tr", {}, [0, 1].map(() => ["robots", "mean fit", "least fit"].map((name) => h("th", { scope: "col" }, name))))),
        h("tbody", {}, all.map((id) => h("tr", { key: id }, h("th", { scope: "row" }, teamName(id)), cells(live.get(id)), cells(proposed.get(id))))));
}

/** @param {any} division */
function moves(division) {
    const list = division.moves.slice(0, MAX_LISTED);
    return h("div", {},
        h("p", { id: "if-moved" }, division.moved ? `${counted(division.moved, "robot")} would move.` : "No robot would move."),
        h("ul", { class: "moves", id: "if-moves" }, list.map((/** @type {any} */ one) => h("li", { key: one.robot },
            robotLink(one.robot), " ", teamName(one.from), " → ", teamName(one.to)))),
        division.moved > list.length ? h("p", { class: "dim" }, `and ${division.moved - list.length} more`) : null);
}

/** @param {any} division @param {boolean} isThere */
function shown(division, isThere) {
    const one = state.whatIf;
    return h("div", {},
        division.conflict ? h("p", { class: "warn" }, division.conflict) : null,
        h("div", { class: "scroll", tabIndex: 0, role: "group", "aria-label": "Quality" }, quality(division)),
        h("div", { class: "scroll", tabIndex: 0, role: "group", "aria-label": "Teams" }, teams(division)),
        moves(division),
        division.unassigned ? h("p", {}, `Without a team: ${counted(division.unassigned, "robot")}.`) : null,
        h("div", { class: "line" },
            h("button", { type: "button", id: "if-map", "aria-pressed": String(one.onMap), onClick: () => {
                one.onMap = !one.onMap;
                changed();
                draw();
            } }, "Show on the map"),
            h("button", { type: "button", id: "if-accept", disabled: !canCommand() || !isThere, onClick: () => accept(one.proposal) }, "Accept"),
            h("button", { type: "button", id: "if-reject", onClick: reject }, "Reject")));
}

export function WhatIf() {
    const one = state.whatIf;
    const fields = Object.keys(one.asked);
    const division = one.proposal?.division;
    const left = one.proposal ? one.proposal.forgotten_in_s - (now() - one.at) : 0;
    const chosen = state.selected.size;
    return h("fieldset", { id: "what-if" }, h("legend", {}, "What if"),
        fields.length ? h("ul", { id: "if-asked" }, fields.map((field) => h("li", { key: field }, WORDS[field](one.asked[field]), " ",
            h("button", { type: "button", "aria-label": `Leave out ${WORDS[field](one.asked[field])}`, onClick: () => {
                delete one.asked[field];
                if (fields.length > 1) void ask();
                else reject();
            } }, "×")))) : h("p", {}, "Choose above what is to be different, or robots on the map that are to be in no team."),
        h("div", { class: "line" },
            h("button", { type: "button", id: "if-without", disabled: !canCommand() || !chosen || chosen > MAX_WITHOUT,
                onClick: () => whatIf({ without: [...state.selected].sort() }) }, `Without the ${counted(chosen, "selected robot")}`),
            fields.length ? h("button", { type: "button", id: "if-again", disabled: !canCommand() || one.isAsking, onClick: () => void ask() }, "Ask again") : null),
        h("div", { role: "status" },
            one.isAsking ? h("p", {}, "The planner computes it …") : null,
            one.problem ? h("p", { class: "warn", id: "if-problem" }, one.problem) : null,
            division ? h("p", { class: left > 0 ? "dim" : "warn", id: "if-age" }, left > 0
                ? "It is of one moment; the planner forgets it a minute after it was computed."
                : `The planner has forgotten it after ${age(now() - one.at)}. Ask again.`) : null),
        division ? shown(division, left > 0) : null);
}
