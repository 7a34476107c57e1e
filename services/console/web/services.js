// Health of the services: which instance leads, at what rate it publishes, how long it takes over a frame, and how old what
// it published last is.

import { age, counted } from "./format.js";
import { now, state } from "./state.js";
import { h } from "./vendor/preact.js";

/** @type {Record<string, string>} */
const STANDING = { holding: "leads", standby: "standby", starting: "starting", doubtful: "in doubt" };

/** Outputs per second since the status before. @param {any} one */
function rate(one) {
    const before = state.before?.instances?.find((/** @type {any} */ other) =>
        other.service === one.service && other.instance === one.instance);
    const seconds = before ? (one.now - before.now) / 1e6 : 0;
    if (!(seconds > 0) || before.revision.term !== one.revision.term) return "–";
    return ((one.revision.epoch - before.revision.epoch) / seconds).toFixed(1);
}

/** What the newest audit says of a leader: how long it took over its frame, and when it published it. @param {any} one */
function stage(one) {
    const found = (state.audit?.stages ?? []).find((/** @type {any} */ stage) => stage.stage === one.service);
    if (one.standing !== "holding" || !found) return ["–", "–"];
    return [age(found.published - found.received), age(now() - found.published)];
}

export function Services() {
    const { services, hello, fleet } = state;
    const instances = services?.instances ?? [];
    const needed = hello?.services ?? [];
    const leads = new Set(instances.filter((/** @type {any} */ one) => one.standing === "holding").map((/** @type {any} */ one) => one.service));
    const missing = needed.filter((/** @type {string} */ name) => !leads.has(name));
    const names = ["service", "instance", "is", "outputs/s", "lag", "output", "term", "runs for", "version", "state"];
    return h("div", {},
        h("h2", {}, "Link"),
        h("p", { id: "link-state", class: state.link ? "" : "warn" }, state.link
            ? "The router is linked."
            : "The link to the router is lost. Nothing here says whether a robot or a service is."),
        Object.entries(fleet?.stale ?? {}).filter(([, why]) => why).map(([name, why]) =>
            h("p", { class: "warn", key: name }, `What is shown of ${name} is old: ${why === "silent" ? "no service has said anything newer" : why === "restarted" ? "the services began anew" : "the link was lost"}.`)),
        h("h2", {}, counted(instances.length, "instance")),
        missing.length ? h("p", { class: "warn" }, `No instance leads: ${missing.join(", ")}.`) : null,
        h("div", { class: "scroll", tabIndex: 0, role: "group", "aria-label": "Table" }, h("table", { id: "services" },
            h("caption", {}, "Lag: how long a leader takes over a frame. Output: how long ago it published the last one that the audit rests on."),
            h("thead", {}, h("tr", {}, names.map((name) => h("th", { scope: "col" }, name)))),
            h("tbody", {}, instances.map((/** @type {any} */ one) => h("tr", { key: `${one.service} ${one.instance}`, "data-service": one.service },
                h("th", { scope: "row" }, one.service),
                h("td", {}, one.instance),
                h("td", {}, STANDING[one.standing] ?? one.standing),
                h("td", { class: "number" }, rate(one)),
                stage(one).map((text) => h("td", { class: "number" }, text)),
                h("td", { class: "number" }, one.revision.term),
                h("td", {}, age((one.now - one.started) / 1e6)),
                h("td", {}, one.version),
                h("td", {}, one.state)))))));
}
