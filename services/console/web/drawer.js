// One robot: where it is, why it is in its team, and in which teams it was.

import { canCommand } from "./alerts.js";
import { age, clock, fixed } from "./format.js";
import { flagsOf, hasPlace, HELD, LEADER, LOST, PINNED, placeOf, PROVISIONAL, STALE } from "./frame.js";
import { ask, sendView } from "./link.js";
import { robotLink, teamName } from "./teams.js";
import { now, select, state, teamOf } from "./state.js";
import { Component, h } from "./vendor/preact.js";
import { whatIf } from "./whatif.js";

/** How often the reason is asked for again, in milliseconds. */
const REASON_EVERY = 3000;

/** @param {any} why */
function reasons(why) {
    const modalities = why.teams[0]?.modalities.map((/** @type {any} */ pull) => pull.modality) ?? [];
    const names = ["team", "robots", "total", ...modalities, "itself", "spread", "price", "hysteresis"];
    return h("div", {},
        h("p", { id: "why" }, why.text),
        h("div", { class: "scroll", tabIndex: 0, role: "group", "aria-label": "Table" }, h("table", {},
            h("caption", {}, "What draws it to each team; the largest total decides"),
            h("thead", {}, h("tr", {}, names.map((name) => h("th", { scope: "col" }, name)))),
            h("tbody", {}, why.teams.map((/** @type {any} */ team) => h("tr", { key: team.team },
                h("th", { scope: "row" }, teamName(team.team)),
                h("td", { class: "number" }, team.max ? `${team.robots}/${team.max}` : team.robots),
                h("td", { class: "number" }, fixed(team.total, 3)),
                team.modalities.map((/** @type {any} */ pull) => h("td", { class: "number" }, fixed(pull.pull, 3))),
                h("td", { class: "number" }, fixed(team.itself, 3)),
                h("td", { class: "number" }, fixed(team.spread, 3)),
                h("td", { class: "number" }, fixed(-team.price, 3)),
                h("td", { class: "number" }, fixed(team.hysteresis, 3))))))));
}

/** Links that are listed. */
const MAX_LINKS = 12;

/** Its strongest links of the modality that the map shows. @param {number} index */
function links(index) {
    const frame = state.links;
    if (!frame || frame.names !== state.names) return "…";
    const found = [];
    for (let number = 0; number < frame.count; number++) {
        const [word, to] = [frame.words[2 * number], frame.words[2 * number + 1]];
        const from = word & 0xffffff;
        if (from !== index && to !== index) continue;
        found.push({ robot: state.robots[from === index ? to : from]?.robot ?? "", share: (word >>> 24) / 255, out: from === index });
    }
    found.sort((left, right) => right.share - left.share);
    if (!found.length) return `none of ${state.view.links}`;
    return h("span", {}, found.slice(0, MAX_LINKS).map((one, number) =>
        h("span", { key: number }, number ? ", " : "", one.out ? "→ " : "← ", robotLink(one.robot), ` ${Math.round(100 * one.share)} %`)),
    found.length > MAX_LINKS ? ` and ${found.length - MAX_LINKS} more` : "", " of the strongest one shown");
}

export class Drawer extends Component {
    constructor() {
        super();
        this.robot = "";
        /** @type {Record<string, any>} */
        this.state = { why: null, problem: "", past: null, pastProblem: "" };
        this.timer = 0;
    }

    componentDidMount() {
        this.timer = window.setInterval(() => this.#ask(), REASON_EVERY);
        this.#ask();
    }

    componentDidUpdate() {
        if (this.robot !== state.opened) this.#ask();
    }

    componentWillUnmount() {
        clearInterval(this.timer);
    }

    #ask() {
        const robot = state.opened;
        if (!robot || state.socket !== "open") return;
        const isNew = robot !== this.robot;
        this.robot = robot;
        if (isNew) this.setState({ why: null, problem: "", past: null, pastProblem: "" });
        const here = () => this.robot === robot;
        ask({ why: robot }).then(
            (why) => here() && this.setState({ why, problem: "" }),
            (error) => here() && this.setState({ why: null, problem: error.message }));
        if (!isNew) return;
        ask({ history: `robot=${robot};limit=20` }).then(
            (past) => here() && this.setState({ past }),
            (error) => here() && this.setState({ pastProblem: error.message }));
    }

    render() {
        const robot = state.opened;
        if (!robot) return null;
        const index = state.index.get(robot) ?? -1;
        const [line, frame] = [state.robots[index], state.ground];
        const known = frame && index >= 0 && index < frame.count;
        const flags = known ? flagsOf(frame, index) : 0;
        const names = /** @type {[number, string][]} */ ([[STALE, "silent"], [LOST, "lost"], [PINNED, "bound by a wish"],
            [PROVISIONAL, "provisional: one modality alone relates it"], [LEADER, "leads its team"], [HELD, "held in its team for now"]]);
        const states = names.filter(([flag]) => flags & flag).map(([, name]) => name);
        const gone = state.lost.robots.find((/** @type {any} */ one) => one.robot === robot);
        const place = known && hasPlace(frame, index) ? placeOf(frame, index) : null;
        const heading = known ? frame.bytes[8 * index + 6] : 255;
        const loss = (state.audit?.losses ?? []).find((/** @type {any} */ one) => one.robot === robot);
        const { why, problem, past, pastProblem } = this.state;
        return h("section", { class: "drawer", "aria-labelledby": "drawer-title", id: "drawer" },
            h("div", { class: "line" },
                h("h2", { id: "drawer-title" }, robot),
                h("button", { type: "button", "aria-label": "Close", onClick: () => { select(""); sendView(); } }, "×")),
            h("dl", {},
                h("dt", {}, "Team"), h("dd", {}, teamName(teamOf(index) || null)),
                h("dt", {}, "State"), h("dd", { class: gone ? "warn" : "" }, states.join(", ") || "active"),
                gone && [h("dt", {}, "Last seen"), h("dd", {}, `${age(now() - gone.last_seen)} ago, at ${clock(gone.last_seen)}`)],
                h("dt", {}, "Place"), h("dd", {}, place ? `${fixed(place[0], 1)} m east, ${fixed(place[1], 1)} m north` : "unknown",
                    heading < 255 ? `, heading ${Math.round((450 - (heading * 360) / 255) % 360)}°` : ""),
                line?.superior && [h("dt", {}, "Superior"), h("dd", {}, robotLink(line.superior))],
                line?.role && [h("dt", {}, "Role"), h("dd", {}, line.role)],
                line?.skills.length ? [h("dt", {}, "Skills"), h("dd", {}, line.skills.join(", "))] : null,
                h("dt", {}, "If it is lost"), h("dd", {}, loss ? loss.effect : "it is not among the ten worst losses", " ",
                    h("button", { type: "button", id: "if-lost", disabled: !canCommand(), onClick: () => {
                        state.panel = "Control";
                        whatIf({ without: [robot] });
                    } }, "What if it is")),
                h("dt", {}, "Links"), h("dd", { id: "links-of" }, state.view.links ? links(index) : "choose a modality above the map")),
            h("h3", {}, "Why it is in its team"),
            why ? reasons(why) : h("p", { class: "dim" }, problem || "…"),
            h("h3", {}, "Teams it was in"),
            pastProblem ? h("p", { class: "dim" }, pastProblem) : null,
            past ? h("ol", { class: "past" }, (past.rows.robot ?? []).slice(0, 20).map((/** @type {any} */ row) =>
                h("li", {}, clock(row.at / 1e6), " ", row.team ? teamName(row.team) : row.present ? "no team" : "gone",
                    row.stale ? " (silent)" : ""))) : null);
    }
}
