// A console that shows the certificate of a viewer, and whose code takes itself for an operator's, next to one that shows the
// certificate of an operator: the router tells them apart.
//
//   node certificate.mjs CHROMIUM ADDRESS_OF_VIEWER ADDRESS_OF_OPERATOR

import assert from "node:assert/strict";

import { address, confirm, muster, open, order, panel, run, step, until, viewerAddress as operatorAddress } from "./page.mjs";

/** Asks for two teams. @param {any} page */
async function command(page) {
    await until(page, () => window.muster?.drawn.count > 0);
    await until(page, () => window.muster.state.settings.clusterer?.teams === 3);
    await panel(page, "Control");
    await page.getByLabel("exactly").check();
    await page.locator("#count-one").fill("2");
    await page.locator("#count-set").click();
    await confirm(page);
}

await run(async () => {
    step("a console with the certificate of a viewer sees everything and commands nothing");
    const viewer = await open({ at: address });
    await command(viewer);
    assert.match(await viewer.locator("#who").textContent(), /operator/);
    await viewer.locator("#orders li[data-order=refused]").waitFor();
    console.log(`it is refused: ${await order(viewer).textContent()}`);
    await viewer.locator("#if-count").click();
    await viewer.locator("#if-problem").waitFor();
    assert.match(await muster("set", "clusterer"), /teams\W+3\b/);

    step("one with the certificate of an operator does");
    const operator = await open({ at: operatorAddress });
    await command(operator);
    await operator.locator("#orders li[data-order=done]").waitFor();
    await until(viewer, () => window.muster.state.settings.clusterer.teams === 2);
    assert.match(await muster("set", "clusterer"), /teams\W+2\b/);
});
