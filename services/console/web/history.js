// What the fleet was: a time line, and the division as it stood at any moment. All of it is marked REPLAY.

import { counted, fixed, moment, words } from "./format.js";
import { ask } from "./link.js";
import { showReplay } from "./map.js";
import { pastWorld } from "./past.js";
import { teamName } from "./teams.js";
import { now, state } from "./state.js";
import { Component, h } from "./vendor/preact.js";

/** How far back the time line goes at first, in seconds. */
const SPANS = [600, 3600, 6 * 3600, 24 * 3600, 7 * 24 * 3600];
const MAX_ROWS = 200;

/** The fleet where nothing was recorded. */
const NOTHING = { sequence: 0, at: 0, teams: [], unassigned: [], stale: [], positions: {} };

export class History extends Component {
    /** Whether the panel was left: what was asked for is of no use any more. */
    isGone = false;

    constructor() {
        super();
        /** @type {Record<string, any>} */
        this.state = { span: 600, at: 0, shown: 0, past: null, rows: [], events: [], problem: "" };
    }

    componentDidMount() {
        this.#load();
    }

    componentWillUnmount() {
        this.isGone = true;
        showReplay(null);
    }

    #load() {
        const since = (now() - this.state.span).toFixed(3);
        const fail = (/** @type {Error} */ error) => this.setState({ problem: error.message });
        ask({ history: `of=divisions;since=${since};limit=${MAX_ROWS}` })
            .then((answer) => this.setState({ rows: answer.rows.divisions ?? [], problem: "" }), fail);
        ask({ history: `of=events;since=${since};limit=${MAX_ROWS}` })
            .then((answer) => this.setState({ events: answer.rows.events ?? [] }), fail);
    }

    /** @param {number} at */
    #show(at) {
        this.setState({ at });
        ask({ history: `as_of=${at.toFixed(6)}` }).then((answer) => {
            if (this.isGone || this.state.at !== at) return;
            const past = answer.rows.as_of ?? null;
            showReplay({ at, world: pastWorld(past ?? NOTHING) });
            this.setState({ shown: at, past, problem: past ? "" : "nothing was recorded until then" });
        }, (error) => this.setState({ problem: error.message }));
    }

    #leave() {
        showReplay(null);
        this.setState({ at: 0, past: null });
    }

    render() {
        const { span, at, shown, past, rows, events, problem } = this.state;
        const end = now();
        const list = [
            ...rows.map((/** @type {any} */ row) => ({ at: row.at / 1e6, text: row.snapshot ? `${counted(row.teams, "team")} of ${row.robots} robots (${words(row.snapshot)})` : `${counted(row.changed, "robot")} in another place; ${counted(row.teams, "team")}` })),
            ...events.map((/** @type {any} */ row) => ({ at: row.at / 1e6, text: `${row.source}: ${words(row.event)}` })),
        ].sort((left, right) => right.at - left.at).slice(0, MAX_ROWS);
        return h("div", { class: state.replay ? "replaying" : "" },
            h("div", { class: "line" },
                h("label", {}, "Last", h("select", { value: span, onChange: (/** @type {any} */ event) =>
                    { this.setState({ span: Number(event.target.value) }); setTimeout(() => this.#load()); } },
                SPANS.map((one) => h("option", { value: one, selected: one === span }, one < 3600 ? `${one / 60} minutes` : `${one / 3600} hours`)))),
                h("button", { type: "button", onClick: () => this.#load() }, "Load"),
                state.replay ? h("button", { type: "button", id: "leave-replay", onClick: () => this.#leave() }, "Back to now") : null),
            h("label", {}, "Moment", h("input", { type: "range", id: "moment", min: end - span, max: end, step: 0.1, value: at || end,
                "aria-valuetext": at ? moment(at) : "now",
                onChange: (/** @type {any} */ event) => this.#show(Number(event.target.value)) })),
            problem ? h("p", { class: "warn" }, problem) : null,
            past ? h("section", { id: "past", "aria-labelledby": "past-title" },
                h("h2", { id: "past-title" }, `REPLAY: the division at ${moment(shown)}`),
                h("p", {}, `Recorded at ${moment(past.at / 1e6)}. `, past.audit ? `Mean silhouette ${fixed(past.audit.mean)}, ${past.audit.verdict}.` : "",
                    past.positions_at === null ? " No positions were recorded until then." : ` The map shows the positions of ${moment(past.positions_at / 1e6)}.`),
                h("table", {}, h("thead", {}, h("tr", {}, ["team", "leader", "robots"].map((name) => h("th", { scope: "col" }, name)))),
                    h("tbody", {}, past.teams.map((/** @type {any} */ team) => h("tr", { key: team.id },
                        h("th", { scope: "row" }, teamName(team.id)), h("td", {}, team.leader ?? "–"),
                        h("td", {}, `${team.members.length}: ${team.members.slice(0, 40).join(" ")}${team.members.length > 40 ? " …" : ""}`))))),
                h("p", {}, `Without a team: ${past.unassigned.join(" ") || "none"}. Silent: ${past.stale.join(" ") || "none"}.`)) : null,
            h("h2", {}, "Time line"),
            h("ol", { class: "events", id: "time-line" }, list.map((row, number) => h("li", { key: number },
                h("button", { class: "link", type: "button", onClick: () => this.#show(row.at) }, moment(row.at)), ` ${row.text}`))));
    }
}
