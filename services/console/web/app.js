// The page: the map on the left, one panel on the right, and above both what must never be overlooked.

import { Alerts } from "./alerts.js";
import { Charts } from "./charts.js";
import { Confirm } from "./confirm.js";
import { Control } from "./control.js";
import { Drawer } from "./drawer.js";
import { age, counted } from "./format.js";
import { History } from "./history.js";
import { connect, signIn, signOut } from "./link.js";
import { draw, drawn, fit, frames, MapView, screenOf, showEmbedding, showLinks } from "./map.js";
import { Services } from "./services.js";
import { changed, now, select, state, subscribe } from "./state.js";
import { Teams } from "./teams.js";
import { Component, h, render } from "./vendor/preact.js";

/** @type {[string, any][]} */
const PANELS = [["Teams", Teams], ["Alerts", Alerts], ["Control", Control], ["Over time", Charts], ["History", History], ["Services", Services]];

class SignIn extends Component {
    constructor() {
        super();
        this.state = { token: "", problem: "" };
    }

    render() {
        const { token, problem } = this.state;
        return h("main", { class: "sign-in" },
            h("h1", {}, "Muster"),
            h("form", { onSubmit: async (/** @type {Event} */ event) => {
                event.preventDefault();
                this.setState({ problem: await signIn(token) });
            } },
            h("label", {}, "Token", h("input", { type: "password", id: "token", autocomplete: "current-password", value: token,
                onInput: (/** @type {any} */ event) => this.setState({ token: event.target.value }) })),
            h("button", { type: "submit" }, "Sign in"),
            h("p", { class: "warn", role: "alert" }, problem)));
    }
}

/** When the data behind a division is old, in seconds: what readers of a division wait for a newer one. */
const OLD_AFTER = 5;

/** Whether an instance of a service led when so much was known of the services. @param {any} known @param {string} service */
const led = (known, service) => known.instances.some((/** @type {any} */ one) =>
    one.service === service && one.standing === "holding");

/** Whether no instance leads, now and when it was last said: the first that a page receives may lack statuses. @param {string} service */
const isIdle = (service) => state.before && !led(state.before, service) && !led(state.services, service);

function banner() {
    if (state.replay) return h("p", { class: "banner replay", role: "status" }, "REPLAY – this is the past");
    if (state.socket !== "open") return h("p", { class: "banner lost", role: "status" }, "The console is not reached. What is shown is old; it connects again by itself.");
    if (!state.link) return h("p", { class: "banner lost", role: "status" }, "The link to the router is lost. What is shown is old.");
    if (state.hello?.fleet.startsWith("replay-")) return h("p", { class: "banner replay", role: "status" }, "REPLAY – this fleet is a recording that is played");
    const old = Object.entries(state.fleet?.stale ?? {}).filter(([, why]) => why).map(([name]) => name);
    if (old.length) return h("p", { class: "banner stale", role: "status" }, `No service says anything newer: ${old.join(", ")} may be old.`);
    const idle = ["ingest", "embedder", "clusterer", "auditor"].filter(isIdle);
    const behind = now() - (state.teams?.newest ?? NaN);
    if (idle.length || behind > OLD_AFTER) {
        const why = idle.length ? `No ${idle.join(", no ")} leads: ` : "";
        return h("p", { class: "banner stale", role: "status" }, `${why}the division rests on data of ${age(behind)} ago and may be old.`);
    }
    const [problem] = state.problems.values();
    if (problem) return h("p", { class: "banner stale", role: "status" }, problem);
    return null;
}

/** @param {string} panel */
function show(panel) {
    state.panel = panel;
    changed();
}

class App extends Component {
    constructor() {
        super();
        subscribe(() => this.setState({}));
    }

    componentDidMount() {
        document.addEventListener("keydown", (event) => {
            if (!event.altKey || event.ctrlKey || event.metaKey) return;
            const panel = PANELS[Number(event.key) - 1];
            if (panel) show(panel[0]);
            else if (event.key === "m") document.getElementById("map")?.focus();
            else return;
            event.preventDefault();
        });
    }

    /** @param {KeyboardEvent} event */
    #tab(event) {
        const by = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0;
        if (!by) return;
        event.preventDefault();
        const at = PANELS.findIndex(([name]) => name === state.panel);
        const [name] = PANELS[(at + by + PANELS.length) % PANELS.length];
        show(name);
        document.getElementById(`tab-${name}`)?.focus();
    }

    render() {
        if (state.socket === "sign-in") return h(SignIn, {});
        const { panel } = state;
        const Shown = (PANELS.find(([name]) => name === panel) ?? PANELS[0])[1];
        const frame = state.ground;
        const open = (state.alerts?.open ?? []).filter((/** @type {any} */ one) => !one.acknowledged).length;
        const fresh = frame ? now() - frame.newest : NaN;
        const modalities = state.fleet?.modalities ?? [];
        const places = frames();
        return h("div", { class: `page ${state.replay ? "is-replay" : ""}` },
            h("header", {},
                h("h1", {}, "Muster ", h("span", { class: "dim" }, state.hello?.fleet ?? "")),
                h("span", { id: "count" }, counted(state.robots.length, "robot")),
                h("span", { id: "age", title: "age of the newest position" }, `data ${age(fresh)}`),
                state.lost.count ? h("span", { class: "warn", id: "lost-count" }, `${state.lost.count} missing`) : null,
                h("span", { class: "grow" }),
                h("span", { class: "dim", id: "who" }, state.hello?.operator ? `operator ${state.hello.operator}` : state.hello?.role ?? ""),
                h("button", { type: "button", onClick: () => {
                    const root = document.documentElement;
                    root.dataset.theme = root.dataset.theme === "light" ? "dark" : "light";
                    changed();
                    draw();
                } }, "Light or dark"),
                state.byToken ? h("button", { type: "button", onClick: signOut }, "Sign out") : null),
            banner(),
            h("main", {},
                h("section", { class: "left", "aria-label": "Map" },
                    h("div", { class: "tools" },
                        h("button", { type: "button", onClick: () => { fit(); draw(); } }, "Show all"),
                        h("button", { type: "button", id: "embedding", "aria-pressed": String(state.view.embedding), onClick: () => showEmbedding(!state.view.embedding) }, "Embedding"),
                        state.hello?.image ? h("button", { type: "button", id: "image", "aria-pressed": String(state.view.image), onClick: () => {
                            state.view.image = !state.view.image;
                            changed();
                            draw();
                        } }, "Image") : null,
                        h("label", {}, "Links", h("select", { id: "links", value: state.view.links, onChange: (/** @type {any} */ event) => showLinks(event.target.value) },
                            h("option", { value: "" }, "none"), modalities.map((/** @type {string} */ name) => h("option", { value: name }, name)))),
                        places.length > 1 && !state.view.embedding && !state.filter.frame && !state.replay
                            ? h("span", { class: "warn", id: "frames" }, `Positions of ${places.length} frames (${places.slice(0, 3).join(", ")}${places.length > 3 ? " …" : ""}) are drawn as if they were one; the filter shows one of them.`)
                            : null,
                        h("span", { class: "dim", id: "chosen" }, state.selected.size ? `${state.selected.size} selected` : "")),
                    h(MapView, {})),
                h("section", { class: "right", "aria-label": "Panel" },
                    h("div", { role: "tablist", "aria-label": "Panels", onKeyDown: (/** @type {KeyboardEvent} */ event) => this.#tab(event) },
                        PANELS.map(([name]) => h("button", {
                            type: "button", role: "tab", id: `tab-${name}`, "aria-selected": String(name === panel), "aria-controls": "panel",
                            tabIndex: name === panel ? 0 : -1, onClick: () => show(name),
                        }, name, name === "Alerts" && open ? ` (${open})` : ""))),
                    state.opened ? h(Drawer, {}) : null,
                    h("div", { role: "tabpanel", id: "panel", "aria-labelledby": `tab-${panel}`, tabIndex: 0, class: "panel" }, h(Shown, { key: panel })))),
            h(Confirm, {}));
    }
}

document.documentElement.dataset.theme = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
// What tests read; nothing of the page does.
Object.assign(window, { muster: { state, drawn, draw, select, screenOf } });
render(h(App, {}), /** @type {Element} */ (document.getElementById("root")));
connect(draw);
// Ages grow although nothing arrives.
setInterval(changed, 1000);
