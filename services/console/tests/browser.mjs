// The console in a real browser against real services. The Rust test that starts this kills and starts processes where a
// line `do …` asks for it, and answers with one line of JSON.
//
//   node browser.mjs CHROMIUM ADDRESS VIEWER_ADDRESS PICTURES

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { createInterface } from "node:readline";

const packages = createRequire(`${process.env.MUSTER_WEB_PACKAGES}/`);
const { chromium } = packages("playwright-core");
const { source: axeSource } = packages("axe-core");

const [, , executablePath, address, viewerAddress, pictures] = process.argv;
const lines = createInterface({ input: process.stdin })[Symbol.asyncIterator]();

/** Has the Rust test do something. @param {string[]} what */
async function act(...what) {
    console.log(`do ${JSON.stringify(what)}`);
    const { value } = await lines.next();
    return JSON.parse(value);
}

/** What `muster` prints. @param {string[]} args */
async function muster(...args) {
    const { code, out, err } = await act("muster", ...args);
    assert.equal(code, 0, `muster ${args.join(" ")}: ${err}`);
    return out;
}

/** How long anything may take, in milliseconds: a browser that draws in software shares the machine with other tests. */
const WITHIN = 120_000;

const step = (name) => console.log(`step ${name}`);

const browser = await chromium.launch({
    executablePath,
    args: ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"],
});

/** @type {string[]} */
const problems = [];

/** @param {object} [options] */
async function open(options = {}) {
    const { at = address, ...rest } = options;
    const context = await browser.newContext({ viewport: { width: 1280, height: 720 }, colorScheme: "dark", ...rest });
    // The clock of the browser is an hour off.
    await context.addInitScript(() => {
        const now = Date.now;
        Date.now = () => now() + 3_600_000;
    });
    // While the page is worked on it may be taken from its folder, without building the program anew.
    if (process.env.MUSTER_WEB_FOLDER) {
        await context.route(/\.(js|css)$/, async (route) => {
            const response = await route.fetch({ maxRetries: 3 });
            const body = await readFile(`${process.env.MUSTER_WEB_FOLDER}${new URL(route.request().url()).pathname}`);
            await route.fulfill({ response, body });
        });
    }
    context.setDefaultTimeout(WITHIN);
    const page = await context.newPage();
    page.on("pageerror", (error) => problems.push(String(error)));
    page.on("console", (message) => {
        const expected = /WebSocket|ERR_CONNECTION|Failed to load|401|Content Security Policy|GPU stall|GL Driver/;
        if (message.type() === "error" && !expected.test(message.text())) problems.push(message.text());
    });
    await page.goto(`http://${at}/`);
    return page;
}

/** Waits until something holds in the page. @param {any} page @param {Function} test @param {any} [argument] */
const until = (page, test, argument, timeout = WITHIN) => page.waitForFunction(test, argument, { timeout, polling: 100 });

/** @param {any} page @param {string} name */
const panel = (page, name) => page.getByRole("tab", { name }).click();

/** The last command of the page. @param {any} page */
const order = (page) => page.locator("#orders li").first();

/** @param {any} page @param {string} name */
async function axe(page, name) {
    // The policy of the page keeps scripts out of it; the protocol of the browser may evaluate all the same.
    const session = await page.context().newCDPSession(page);
    const evaluate = async (expression) => {
        const { result, exceptionDetails } = await session.send("Runtime.evaluate", { expression, awaitPromise: true, returnByValue: true });
        assert.equal(exceptionDetails, undefined, JSON.stringify(exceptionDetails));
        return result.value;
    };
    await evaluate(`${axeSource}; 0`);
    const findings = await evaluate(`axe.run(document).then(({ violations }) => violations.map((one) =>
        one.id + ": " + one.nodes.map((node) => node.html.slice(0, 160) + " " + node.failureSummary).join(" | ")))`);
    await session.detach();
    assert.deepEqual(findings, [], name);
}

const picture = (page, name) => (pictures ? page.screenshot({ path: `${pictures}/${name}.png` }) : null);

try {
    step("the page shows the fleet");
    const started = Date.now();
    const page = await open();
    await until(page, () => window.muster?.drawn.count > 0);
    console.log(`first picture after ${Date.now() - started} ms`);
    await until(page, () => document.querySelectorAll("#teams tbody tr").length === 3);
    await until(page, () => window.muster.state.robots.length === 12);
    const painted = await page.evaluate(() => window.muster.drawn.count);
    await until(page, (count) => window.muster.drawn.count > count + 20, painted);
    assert.match(await page.locator("#age").textContent(), /^data (\d+ ms|[01]\.\d s)$/);
    assert.equal(await page.locator(".banner").count(), 0);
    // Something is drawn: more than one colour stands on the map.
    const colors = await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => {
        const canvas = document.querySelector("canvas.gl");
        const copy = document.createElement("canvas");
        [copy.width, copy.height] = [canvas.width, canvas.height];
        const pen = copy.getContext("2d");
        window.muster.draw();
        pen.drawImage(canvas, 0, 0);
        const { data } = pen.getImageData(0, 0, copy.width, copy.height);
        resolve(new Set(new Uint32Array(data.buffer)).size);
    })));
    assert.ok(colors > 4, `${colors} colours on the map`);
    await picture(page, "map");

    step("an inline script is stopped");
    const violations = await page.evaluate(async () => {
        const seen = [];
        document.addEventListener("securitypolicyviolation", (event) => seen.push(event.violatedDirective));
        const script = document.createElement("script");
        script.textContent = "window.evil = 1";
        document.body.append(script);
        document.body.insertAdjacentHTML("beforeend", "<img src=x onerror='window.evil = 2'><a id=bad href='javascript:window.evil=3'>x</a>");
        document.getElementById("bad").click();
        await fetch("http://127.0.0.1:9/").catch(() => {});
        await new Promise((resolve) => setTimeout(resolve, 300));
        document.body.querySelectorAll(":scope > img, :scope > a, :scope > script").forEach((one) => one.remove());
        return { evil: window.evil, seen };
    });
    assert.equal(violations.evil, undefined);
    assert.ok(violations.seen.length >= 3, JSON.stringify(violations));

    step("search, selection and reasons");
    const robots = await page.evaluate(() => window.muster.state.robots.map((one) => one.robot));
    await page.locator("#search").fill(robots[0]);
    await page.locator("ul.robots button").first().click();
    await page.locator("#drawer").waitFor();
    await page.locator("#why").waitFor();
    assert.ok((await page.locator("#why").textContent()).includes(robots[0]));
    await picture(page, "robot");
    await page.locator("#search").fill("");

    step("links and embedding");
    await page.locator("#links").selectOption("spatial");
    await until(page, () => window.muster.state.links?.count > 0);
    await page.locator("#embedding").click();
    await until(page, () => window.muster.state.embedding?.count === 12);
    await picture(page, "embedding");
    await page.locator("#embedding").click();
    await page.locator("#links").selectOption("");

    step("a command is carried out, and asked twice");
    await panel(page, "Control");
    await page.getByLabel("exactly").check();
    await page.locator("#count-one").fill("2");
    await page.locator("#count-set").click();
    await page.getByRole("button", { name: "Cancel" }).click();
    assert.equal(await page.locator("#orders li").count(), 0);
    await page.locator("#count-set").click();
    await page.getByRole("button", { name: "Do it" }).click();
    await page.locator("#orders li[data-order=done]").waitFor();
    assert.match(await muster("set", "clusterer"), /teams\W+2\b/);
    await until(page, () => document.getElementById("count-now").textContent === "2");
    await picture(page, "control");

    step("a refusal shows its reason");
    await page.locator("#count-one").fill("5000");
    await page.locator("#count-set").click();
    await page.getByRole("button", { name: "Do it" }).click();
    await page.locator("#orders li[data-order=refused]").waitFor();
    assert.match(await order(page).textContent(), /teams/);
    await page.locator("#count-one").fill("3");
    await page.locator("#count-set").click();
    await page.getByRole("button", { name: "Do it" }).click();
    await until(page, () => document.getElementById("count-now").textContent === "3");

    step("weights keep their sum");
    await page.locator("#weight-spatial").focus();
    const weight = Number(await page.locator("#weight-spatial").inputValue());
    for (let press = 0; press < 20; press++) await page.keyboard.press("ArrowRight");
    await page.locator("#weights-set").click();
    await page.getByRole("button", { name: "Do it" }).click();
    await until(page, () => window.muster.state.settings.embedder.weights.spatial);
    const weights = await page.evaluate(() => window.muster.state.settings.embedder.weights);
    const sum = Object.values(weights).reduce((one, other) => one + other, 0);
    assert.ok(Math.abs(sum - 1) < 1e-9 && weights.spatial > weight, JSON.stringify([weight, weights]));
    assert.match(await muster("set", "embedder"), new RegExp(`spatial\\W+${weights.spatial}`));

    step("a change is taken back");
    await page.getByRole("button", { name: "Undo weights" }).click();
    await page.getByRole("button", { name: "Do it" }).click();
    await until(page, () => Object.keys(window.muster.state.settings.embedder.weights).length === 0);

    step("limits and needs");
    await page.locator("#limit-max").fill("9");
    await page.locator("#limits-set").click();
    await page.getByRole("button", { name: "Do it" }).click();
    await until(page, () => document.getElementById("limits-now").textContent.includes("– to 9"));
    assert.match(await muster("set", "clusterer"), /"?max"?\W+9\b/);
    await page.locator("#limit-max").fill("");
    await page.locator("#limits-set").click();
    await page.getByRole("button", { name: "Do it" }).click();
    await page.locator("#need-skill").fill("medic");
    await page.locator("#need-add").click();
    await page.getByRole("button", { name: "Do it" }).click();
    // No robot is a medic: the service refuses it with the numbers.
    await page.locator("#orders li[data-order=refused]", { hasText: "medic" }).waitFor();
    assert.match(await order(page).textContent(), /0 robots with medic/);

    step("a pin is granted and withdrawn");
    const team = await page.evaluate((robot) => {
        const { state } = window.muster;
        const slot = state.ground.shorts[4 * state.index.get(robot) + 2];
        return state.teams.teams.map((one) => one.id).filter((_, number) => number !== slot)[0];
    }, robots[0]);
    await page.locator("#wish-kind").selectOption("pin");
    await page.locator("#wish-team").selectOption(team);
    await page.locator("#wish-put").click();
    await page.locator(`#wishes li[data-state=active]`).waitFor();
    const wishes = (await muster("wish", "list", "--json")).trim().split("\n").map((line) => JSON.parse(line));
    assert.deepEqual(wishes.map((one) => [one.wish.kind, one.wish.robots, one.wish.team, one.operator]), [["pin", [robots[0]], team, "kim"]]);
    await until(page, (robot) => {
        const { state } = window.muster;
        return (state.ground.bytes[8 * state.index.get(robot) + 7] & 4) !== 0;
    }, robots[0]);
    await page.locator("#wishes button").first().click();
    await page.getByRole("button", { name: "Do it" }).click();
    await until(page, () => !document.querySelector("#wishes li[data-state=active]"));

    step("two browsers agree, and ten at once are served");
    const others = [];
    for (let number = 0; number < 9; number++) others.push(await open());
    await Promise.all(others.map((other) => until(other, () => window.muster?.drawn.count > 5)));
    const seen = async (one) => one.evaluate(() => ({
        epoch: window.muster.state.teams.epoch,
        teams: window.muster.state.teams.teams.map((team) => [team.id, team.members]),
        count: window.muster.state.settings.clusterer?.teams,
    }));
    await until(others[0], () => window.muster.state.settings.clusterer);
    const [mine, yours] = [await seen(page), await seen(others[0])];
    assert.deepEqual([mine.teams, mine.count], [yours.teams, yours.count]);
    await Promise.all(others.map((other) => other.context().close()));

    step("a robot that is killed greys and stays");
    await act("kill-robot");
    await panel(page, "Teams");
    await until(page, () => document.querySelector("#missing-robots tbody tr"));
    const missing = await page.locator("#missing-robots tbody th").allTextContents();
    assert.match(await page.locator("#missing-robots tbody tr").first().textContent(), /ago/);
    await until(page, (robot) => {
        const { state } = window.muster;
        return (state.ground.bytes[8 * state.index.get(robot) + 7] & 3) !== 0;
    }, missing[0]);
    await until(page, () => window.muster.state.lost.robots.some((one) => one.state === "lost"));
    assert.ok(await page.evaluate((robot) => window.muster.state.index.has(robot), missing[0]));
    await picture(page, "missing");

    step("an alert is acknowledged");
    // A team of at most five robots counts as too small: all three do.
    await muster("set", "auditor", "singleton=5");
    await panel(page, "Alerts");
    const small = page.locator("#alerts li", { hasText: "singleton" });
    await small.first().waitFor();
    const id = await small.first().getAttribute("data-alert");
    const alert = page.locator(`#alerts li[data-alert="${id}"]`);
    await alert.getByRole("button", { name: "Acknowledge singleton" }).click();
    await alert.getByText("seen by kim").waitFor();
    const acknowledged = JSON.parse(await muster("alerts", "--json")).open.find((one) => String(one.id) === id);
    assert.equal(acknowledged.acknowledged.operator, "kim");
    await picture(page, "alerts");

    step("a killed embedder shows stale and recovers without a reload");
    await act("kill", "embedder");
    await page.locator(".banner.stale", { hasText: "may be old" }).waitFor();
    await panel(page, "Services");
    await page.getByText("No instance leads: embedder").waitFor();
    await act("start", "embedder");
    await until(page, () => !document.querySelector(".banner"));
    await until(page, () => document.querySelector("tr[data-service=embedder]"));
    await picture(page, "services");

    step("over time, history and replay");
    await panel(page, "Over time");
    await page.locator("#charts canvas").first().waitFor();
    await picture(page, "over-time");
    await panel(page, "History");
    await page.locator("#time-line li").first().waitFor();
    await page.locator("#time-line li button").first().click();
    await page.locator("#past").waitFor();
    await page.locator(".banner.replay").waitFor();
    await page.locator(".watermark").waitFor();
    await picture(page, "replay");
    await axe(page, "replay");
    await page.locator("#leave-replay").click();
    await until(page, () => !document.querySelector(".banner"));

    step("no finding of axe in any panel, dark and light");
    for (const theme of ["dark", "light"]) {
        for (const name of ["Teams", "Alerts", "Control", "Over time", "History", "Services"]) {
            await panel(page, name);
            await page.waitForTimeout(300);
            await axe(page, `${name}, ${theme}`);
        }
        await page.getByRole("button", { name: "Light or dark" }).click();
    }

    step("everything by keyboard");
    await page.keyboard.press("Alt+1");
    await page.keyboard.press("Alt+m");
    assert.equal(await page.evaluate(() => document.activeElement.id), "map");
    await page.keyboard.press("Escape");
    await page.keyboard.press("n");
    await page.locator("#drawer").waitFor();
    const first = await page.locator("#drawer-title").textContent();
    await page.keyboard.press("n");
    await until(page, (name) => document.getElementById("drawer-title").textContent !== name, first);
    await axe(page, "drawer");
    for (const key of ["ArrowLeft", "+", "-", "f", "Escape"]) await page.keyboard.press(key);
    await until(page, () => !document.getElementById("drawer"));

    step("the console is killed while a command is pending");
    await panel(page, "Control");
    await page.getByLabel("exactly").check();
    await page.locator("#count-one").fill("2");
    await page.locator("#count-set").click();
    await act("stop", "clusterer");
    await page.getByRole("button", { name: "Do it" }).click();
    await page.locator("#orders li[data-order=pending]").waitFor();
    await act("kill-console");
    await page.locator("#orders li[data-order=unknown]").waitFor();
    await page.locator(".banner.lost").waitFor();
    await act("continue", "clusterer");
    await act("start-console");
    await until(page, () => window.muster.state.socket === "open" && window.muster.state.link);
    const settled = /teams\W+(\d+)/.exec(await muster("set", "clusterer"))[1];
    await until(page, (text) => document.getElementById("count-now").textContent === text, settled);
    console.log(`after the reconnect the page shows ${settled} teams, as the service says`);

    step("a viewer cannot command");
    const viewer = await open({ at: viewerAddress });
    await axe(viewer, "sign in");
    await viewer.locator("#token").fill("wrong");
    await viewer.getByRole("button", { name: "Sign in" }).click();
    await viewer.getByText("this token is unknown").waitFor();
    await viewer.locator("#token").fill("wall-wall-wall-wall-wall-wall");
    await viewer.getByRole("button", { name: "Sign in" }).click();
    await until(viewer, () => window.muster.drawn.count > 0);
    await panel(viewer, "Control");
    await viewer.locator("#viewer").waitFor();
    const forged = await viewer.evaluate((host) => new Promise((resolve) => {
        const socket = new WebSocket(`ws://${host}/live`);
        socket.onopen = () => socket.send(JSON.stringify({ command: { id: 1, service: "clusterer", action: { set: { teams: 2 } } } }));
        socket.onmessage = ({ data }) => {
            if (typeof data !== "string") return;
            const message = JSON.parse(data);
            if (message.topic === "end") socket.send(JSON.stringify({ credit: message.data.turn }));
            if (message.topic === "reply") resolve(message.data);
        };
    }), viewerAddress);
    assert.match(forged.refused, /viewer cannot command/);
    await viewer.context().close();

    assert.deepEqual(problems, []);
    console.log("everything holds");
} catch (error) {
    const pages = browser.contexts().flatMap((context) => context.pages());
    if (pictures && pages[0]) await pages[0].screenshot({ path: `${pictures}/failure.png` }).catch(() => {});
    console.log(`failed: ${error.stack}`);
    throw error;
} finally {
    await browser.close();
}
process.exit(0);
