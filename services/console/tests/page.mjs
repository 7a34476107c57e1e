// What the tests in a browser share: the browser, the Rust test that started it, and what they do with a page.
//
// The Rust test kills and starts processes where a line `do …` asks for it, and answers with one line of JSON.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { createInterface } from "node:readline";

const packages = createRequire(`${process.env.MUSTER_WEB_PACKAGES}/`);
const { chromium } = packages("playwright-core");
const { source: axeSource } = packages("axe-core");

export const [, , executablePath, address, viewerAddress, pictures] = process.argv;
const lines = createInterface({ input: process.stdin })[Symbol.asyncIterator]();

/** Has the Rust test do something. @param {string[]} what */
export async function act(...what) {
    console.log(`do ${JSON.stringify(what)}`);
    const { value } = await lines.next();
    return JSON.parse(value);
}

/** What `muster` prints. @param {string[]} args */
export async function muster(...args) {
    const { code, out, err } = await act("muster", ...args);
    assert.equal(code, 0, `muster ${args.join(" ")}: ${err}`);
    return out;
}

/** How long anything may take, in milliseconds: a browser that draws in software shares the machine with other tests. */
const WITHIN = 120_000;

export const step = (name) => console.log(`step ${name}`);

export const browser = await chromium.launch({
    executablePath,
    args: ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"],
});

/** @type {string[]} */
export const problems = [];

/** @param {object} [options] */
export async function open(options = {}) {
    const { at = address, ...rest } = options;
    const context = await browser.newContext({ viewport: { width: 1280, height: 720 }, colorScheme: "dark", ...rest });
    // The clock of the browser is an hour off.
    await context.addInitScript(() => {
        const now = Date.now;
        Date.now = () => now() + 3_600_000;
    });
    // While the page is worked on it may be taken from its folder, without building the program again.
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
export const until = (page, test, argument, timeout = WITHIN) => page.waitForFunction(test, argument, { timeout, polling: 100 });

/** @param {any} page @param {string} name */
export const panel = (page, name) => page.getByRole("tab", { name }).click();

/** The last command of the page. @param {any} page */
export const order = (page) => page.locator("#orders li").first();

/** @param {any} page @param {string} name */
export async function axe(page, name) {
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

export const picture = (page, name) => (pictures ? page.screenshot({ path: `${pictures}/${name}.png` }) : null);

/** Says yes to the second question. @param {any} page */
export const confirm = (page) => page.getByRole("button", { name: "Do it" }).click();

/** Runs a test to its end; a failure leaves a picture. @param {() => Promise<void>} test */
export async function run(test) {
    try {
        await test();
        assert.deepEqual(problems, []);
        console.log("everything holds");
    } catch (error) {
        const pages = browser.contexts().flatMap((context) => context.pages());
        if (pictures && pages[0]) await pages[0].screenshot({ path: `${pictures}/failure.png` }).catch(() => {});
        console.log(`failed: ${error.stack}`);
        process.exit(1);
    }
    await browser.close();
    process.exit(0);
}
