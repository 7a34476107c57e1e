// Open alerts with filter and acknowledgement, and events as they come.

import { age, clock, counted, words } from "./format.js";
import { command } from "./link.js";
import { robotLink, teamName } from "./teams.js";
import { now, state } from "./state.js";
import { Component, h } from "./vendor/preact.js";

/** Fields of an event that say nothing of their own. */
const HEAD = new Set(["fleet", "term", "epoch", "data_age_s", "stages", "source", "severity", "event"]);
/** Events that are listed. */
const MAX_LISTED = 100;

/** @param {any} event */
const detail = (event) => Object.entries(event).filter(([name]) => !HEAD.has(name))
    .map(([name, value]) => `${words(name)} ${typeof value === "object" ? JSON.stringify(value) : value}`).join(", ");

export const canCommand = () => state.hello?.role === "operator" && state.socket === "open" && state.link && !state.replay;

export class Alerts extends Component {
    constructor() {
        super();
        this.state = { severity: "", kind: "", seen: true, text: "" };
    }

    render() {
        const { severity, kind, seen, text } = this.state;
        const all = state.alerts?.open ?? [];
        const kinds = [...new Set(all.map((/** @type {any} */ one) => one.kind))].sort();
        const shown = all.filter((/** @type {any} */ one) =>
            (!severity || one.severity === severity) && (!kind || one.kind === kind) && (seen || !one.acknowledged));
        const events = state.events.filter(({ event }) =>
            (!severity || event.severity === severity) && (!text || `${event.event} ${detail(event)}`.includes(text)));
        const pick = (/** @type {string} */ field) => (/** @type {any} */ event) => this.setState({ [field]: event.target.value });
        return h("div", {},
            h("form", { class: "filter", onSubmit: (/** @type {Event} */ event) => event.preventDefault() },
                h("label", {}, "Severity", h("select", { onChange: pick("severity"), value: severity },
                    h("option", { value: "" }, "all"), ["info", "warning", "error"].map((value) => h("option", { value }, value)))),
                h("label", {}, "Kind", h("select", { onChange: pick("kind"), value: kind },
                    h("option", { value: "" }, "all"), kinds.map((value) => h("option", { value }, words(value))))),
                h("label", { class: "check" }, h("input", { type: "checkbox", checked: seen,
                    onChange: (/** @type {any} */ event) => this.setState({ seen: event.target.checked }) }), "acknowledged too")),
            h("h2", {}, counted(all.length, "open alert"), state.alerts?.folded ? ` (${state.alerts.folded} more were folded)` : ""),
            h("ul", { class: "alerts", id: "alerts" }, shown.map((/** @type {any} */ one) => h("li", { key: one.id, class: one.severity, "data-alert": one.id },
                h("div", {},
                    h("strong", {}, words(one.kind)), " ", one.team ? teamName(one.team) : one.modality ?? "",
                    h("span", { class: "dim" }, ` for ${age(now() - one.raised)}, ${one.severity}`)),
                h("div", {}, one.reason),
                one.robots?.length ? h("div", {}, one.robots.map((/** @type {string} */ robot) => [robotLink(robot), " "])) : null,
                one.acknowledged
                    ? h("div", { class: "dim" }, `seen by ${one.acknowledged.operator} at ${clock(one.acknowledged.at)}`)
                    : h("button", { type: "button", disabled: !canCommand(), onClick: () =>
                        command(`acknowledge alert ${one.id}`, "auditor", { acknowledge: { alert: one.id } }) },
                    `Acknowledge ${words(one.kind)}`)))),
            h("h2", {}, "Events"),
            h("label", {}, "Containing ", h("input", { type: "search", value: text, onInput: pick("text") })),
            h("ol", { class: "events" }, events.slice(-MAX_LISTED).reverse().map(({ at, event }) =>
                h("li", { key: `${at} ${event.source} ${event.epoch}`, class: event.severity },
                    h("span", { class: "dim" }, `${clock(at)} ${event.source} `), h("strong", {}, words(event.event)), " ", detail(event)))));
    }
}
