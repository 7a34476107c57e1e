// Lines over time. They begin when the page is opened; what was before stands in the history.

import { state } from "./state.js";
import { Component, h } from "./vendor/preact.js";

/** uPlot comes as a script of its own. */
const Plot = () => /** @type {any} */ (window).uPlot;

/** @param {string} name */
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);

const COLORS = ["#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#d55e00"];

class Chart extends Component {
    /** @type {HTMLElement | null} */
    root = null;

    constructor() {
        super();
        /** @type {any} */
        this.plot = null;
        this.key = "";
    }

    componentDidMount() {
        this.#show();
    }

    componentDidUpdate() {
        this.#show();
    }

    componentWillUnmount() {
        this.plot?.destroy();
    }

    #show() {
        const { lines, data } = this.props;
        const root = /** @type {HTMLElement} */ (this.root);
        if (!root || !Plot() || !root.clientWidth) return;
        const key = `${lines.join()} ${document.documentElement.dataset.theme} ${root.clientWidth}`;
        if (key !== this.key) {
            this.plot?.destroy();
            this.key = key;
            const axis = { stroke: css("--dim"), grid: { stroke: css("--grid") }, ticks: { stroke: css("--grid") } };
            this.plot = new (Plot())({
                width: Math.max(200, root.clientWidth), height: 150, legend: { live: true }, axes: [axis, axis],
                series: [{}, ...lines.map((/** @type {string} */ label, /** @type {number} */ number) =>
                    ({ label, stroke: COLORS[number % COLORS.length], width: 2, spanGaps: true }))],
            }, data, root);
        } else {
            this.plot.setData(data);
        }
    }

    render() {
        const { title, lines, data } = this.props;
        const last = lines.map((/** @type {string} */ name, /** @type {number} */ number) => {
            const value = data[number + 1]?.at(-1);
            return `${name} ${value === null || value === undefined ? "unknown" : value.toPrecision(3)}`;
        });
        return h("figure", { class: "chart" },
            h("figcaption", {}, title, h("span", { class: "dim" }, ` ${last.join(", ")}`)),
            h("div", { class: "plot", "aria-hidden": "true", ref: (/** @type {HTMLElement | null} */ root) => { this.root = root; } }));
    }
}

export function Charts() {
    const [at, mean, physical, returns, dataAge] = state.samples;
    if (!at.length) return h("p", {}, "No audit has arrived yet.");
    const stages = [...state.stages];
    return h("div", { id: "charts" },
        h(Chart, { title: "Quality (mean silhouette)", lines: ["embedding", "ground"], data: [at, mean, physical] }),
        h(Chart, { title: "Churn (returns per robot and minute)", lines: ["returns"], data: [at, returns] }),
        h(Chart, { title: "Age of the data at the decision, in seconds", lines: ["age"], data: [at, dataAge] }),
        h(Chart, { title: "Latency of each stage, in milliseconds", lines: stages.map(([name]) => name), data: [at, ...stages.map(([, line]) => line)] }));
}
