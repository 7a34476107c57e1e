// The console in a real browser against real services.
//
//   node browser.mjs CHROMIUM ADDRESS VIEWER_ADDRESS PICTURES

import assert from "node:assert/strict";

import { act, axe, confirm, muster, open, order, panel, picture, run, step, until, viewerAddress } from "./page.mjs";

await run(async () => {
    step("the page shows the fleet");
    const started = Date.now();
    const page = await open();
    await until(page, () => window.muster?.drawn.count > 0);
    console.log(`first picture after ${Date.now() - started} ms`);
    await until(page, () => document.querySelectorAll("#teams tbody tr").length === 3);
    await until(page, () => window.muster.state.robots.length === 13);
    const painted = await page.evaluate(() => window.muster.drawn.count);
    await until(page, (count) => window.muster.drawn.count > count + 20, painted);
    await until(page, () => /^data (\d+ ms|[01]\.\d s)$/.test(document.querySelector("#age").textContent));
    await until(page, () => document.querySelectorAll(".banner").length === 0);
    console.log(`no banner after ${Date.now() - started} ms`);
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
    await page.locator("ul.robots button", { hasText: robots[0] }).first().click();
    await page.locator("#drawer").waitFor();
    await page.locator("#why").waitFor();
    assert.ok((await page.locator("#why").textContent()).includes(robots[0]));
    await picture(page, "robot");
    await page.locator("#search").fill("");

    step("a name of 64 characters");
    const long = robots.find((robot) => robot.length === 64);
    await page.locator("#search").fill(long);
    // The list may still be that of before the search.
    await page.locator("ul.robots button", { hasText: long }).first().click();
    await until(page, (name) => document.getElementById("drawer-title")?.textContent === name, long);
    const fits = await page.evaluate(() => document.documentElement.scrollWidth <= document.documentElement.clientWidth);
    assert.ok(fits, "the page is wider than its window");
    await page.locator("#search").fill("");

    step("filters by team, role, skill and state");
    const filtered = async (field, value, count) => {
        await page.locator(`#filter-${field}`).selectOption(value);
        await until(page, (count) => document.getElementById("found")?.textContent.includes(`Found: ${count} robot`), count);
        await page.locator(`#filter-${field}`).selectOption("");
    };
    const [firstTeam, size] = await page.evaluate(() => {
        const [team] = window.muster.state.teams.teams;
        return [team.id, team.members];
    });
    await filtered("skill", "medic", 5);
    await filtered("role", "scout", 1);
    await filtered("state", "leader", 3);
    await page.locator("#filter-team").selectOption(firstTeam);
    await until(page, (size) => {
        const number = /(\d+)/.exec(document.getElementById("found")?.textContent ?? "");
        return number && Math.abs(Number(number[1]) - size) <= 1;
    }, size);
    await page.getByRole("button", { name: "Select all" }).click();
    assert.match(await page.locator("#chosen").textContent(), /^\d+ selected$/);
    await page.locator("#filter-team").selectOption("");

    step("positions of two frames are called that, and the filter shows one of them");
    assert.equal(await page.locator("#frames").count(), 0);
    // All robots of the fleet say "map"; the page is made to believe something else of one of them.
    await page.evaluate(() => { window.muster.state.robots[0].frame = "odom"; });
    await page.locator("#frames", { hasText: "Positions of 2 frames (map, odom)" }).waitFor();
    await filtered("frame", "odom", 1);
    await page.evaluate(() => { window.muster.state.robots[0].frame = "map"; });
    await until(page, () => !document.getElementById("frames"));

    step("pan, zoom, fit, a click and a box on the map");
    const box = await page.locator("#map").boundingBox();
    await page.getByRole("button", { name: "Show all" }).click();
    await page.keyboard.down("Shift");
    await page.mouse.move(box.x + 4, box.y + 4);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width - 4, box.y + box.height - 4, { steps: 5 });
    await page.mouse.up();
    await page.keyboard.up("Shift");
    await until(page, () => window.muster.state.selected.size === 13);
    await page.mouse.wheel(0, -300);
    await page.mouse.move(box.x + 50, box.y + 50);
    await page.mouse.down();
    await page.mouse.move(box.x + 150, box.y + 90, { steps: 3 });
    await page.mouse.up();
    await page.getByRole("button", { name: "Show all" }).click();
    const [x, y] = await page.evaluate((robot) => window.muster.screenOf(robot), robots[3]);
    await page.mouse.click(box.x + x, box.y + y);
    await until(page, () => window.muster.state.selected.size === 1);
    await page.keyboard.press("Escape");

    step("many robots are shown by how many are where");
    const dense = await page.evaluate(async () => {
        const [{ HEAD, RECORD, readFrame, LOST }, { discs, SQUARE }, { draw, drawn, fit }] = await Promise.all(
            ["/frame.js", "/density.js", "/map.js"].map((one) => import(one)));
        // 3,000 robots of one team and 999 of another, each in a square kilometre, and one that is lost among the first.
        const count = 4000;
        const buffer = new ArrayBuffer(HEAD + RECORD * count);
        const data = new DataView(buffer);
        data.setUint8(0, 1);
        data.setUint8(1, 1);
        data.setUint32(12, count, true);
        data.setFloat64(32, 1, true);
        for (let index = 0; index < count; index++) {
            const [at, second] = [HEAD + RECORD * index, index >= 3000 && index < 3999];
            data.setUint16(at, (index * 7919) % 1000 + (second ? 4000 : 0), true);
            data.setUint16(at + 2, (index * 104729) % 997, true);
            data.setUint16(at + 4, second ? 1 : 0, true);
            data.setUint8(at + 6, 255);
            data.setUint8(at + 7, index === 3999 ? LOST : 0);
        }
        const frame = readFrame(buffer);
        const marks = new Uint8Array(count);
        const window = [5000, 1000].map((metres) => metres / 5);
        const whole = discs(frame, marks, [0, 999], 5, window);
        const flags = Array.from({ length: whole.frame.count }, (_, disc) => whole.frame.bytes[RECORD * disc + 7]);
        const half = discs(frame, marks, [3000, 999], 5, window);
        marks.fill(2, 0, 3000);
        const filtered = discs(frame, marks, [0, 999], 5, window);
        const { state } = globalThis.window.muster;
        const kept = state.ground;
        state.ground = frame;
        fit();
        draw();
        const shown = drawn.discs;
        state.ground = kept;
        fit();
        draw();
        return {
            robots: [whole, half, filtered].map((one) => one.robots), lost: flags.filter((flag) => flag & LOST).length,
            discs: whole.frame.count, most: Math.ceil(1000 / SQUARE) * Math.ceil(200 / SQUARE), shown, after: drawn.discs,
            last: flags.at(-1),
        };
    });
    assert.deepEqual(dense.robots, [4000, 999, 1000]);
    assert.ok(dense.discs > 100 && dense.discs <= dense.most + 1, JSON.stringify(dense));
    // The lost one has a disc of its own, above the others.
    assert.deepEqual([dense.lost, dense.last], [1, 2]);
    assert.ok(dense.shown > 100 && dense.shown < 2000 && dense.after === 0, JSON.stringify(dense));

    step("links and embedding");
    await page.locator("#links").selectOption("spatial");
    await until(page, () => window.muster.state.links?.count > 0);
    // Of a robot that is chosen, its own alone; the drawer names them.
    const allLinks = await page.evaluate(() => window.muster.state.links.count);
    await page.locator("#map").focus();
    await page.keyboard.press("n");
    await until(page, (count) => window.muster.state.links?.count < count, allLinks);
    await page.locator("#links-of", { hasText: "%" }).waitFor();
    const own = await page.evaluate(() => window.muster.state.links.count);
    await page.keyboard.press("Escape");
    await until(page, (count) => window.muster.state.links?.count > count, own);
    // Of a window that shows a part of the fleet, those of that part.
    for (let press = 0; press < 8; press++) await page.keyboard.press("+");
    await until(page, (count) => window.muster.state.links?.count < count, allLinks);
    await page.keyboard.press("f");
    await until(page, (count) => window.muster.state.links?.count > count, own);
    await page.locator("#embedding").click();
    await until(page, () => window.muster.state.embedding?.count === 13);
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
    await confirm(page);
    await page.locator("#orders li[data-order=done]").waitFor();
    assert.match(await muster("set", "clusterer"), /teams\W+2\b/);
    await until(page, () => document.getElementById("count-now").textContent === "2");
    await picture(page, "control");

    step("a refusal shows its reason");
    await page.locator("#count-one").fill("5000");
    await page.locator("#count-set").click();
    await confirm(page);
    await page.locator("#orders li[data-order=refused]").waitFor();
    assert.match(await order(page).textContent(), /teams/);
    await page.locator("#count-one").fill("3");
    await page.locator("#count-set").click();
    await confirm(page);
    await until(page, () => document.getElementById("count-now").textContent === "3");

    step("weights keep their sum");
    await page.locator("#weight-spatial").focus();
    const weight = Number(await page.locator("#weight-spatial").inputValue());
    for (let press = 0; press < 20; press++) await page.keyboard.press("ArrowRight");
    await page.locator("#weights-set").click();
    await confirm(page);
    await until(page, () => window.muster.state.settings.embedder.weights.spatial);
    const weights = await page.evaluate(() => window.muster.state.settings.embedder.weights);
    const sum = Object.values(weights).reduce((one, other) => one + other, 0);
    assert.ok(Math.abs(sum - 1) < 1e-9 && weights.spatial > weight, JSON.stringify([weight, weights]));
    assert.match(await muster("set", "embedder"), new RegExp(`spatial\\W+${weights.spatial}`));

    step("a change is taken back");
    await page.getByRole("button", { name: "Undo weights" }).click();
    await confirm(page);
    await until(page, () => Object.keys(window.muster.state.settings.embedder.weights).length === 0);

    step("limits and needs");
    await page.locator("#limit-max").fill("9");
    await page.locator("#limits-set").click();
    await confirm(page);
    await until(page, () => document.getElementById("limits-now").textContent.includes("– to 9"));
    assert.match(await muster("set", "clusterer"), /"?max"?\W+9\b/);
    await page.locator("#limit-max").fill("");
    await page.locator("#limits-set").click();
    await confirm(page);
    // No robot is a pilot: the service refuses it with the numbers.
    await page.locator("#need-skill").fill("pilot");
    await page.locator("#need-add").click();
    await confirm(page);
    await page.locator("#orders li[data-order=refused]", { hasText: "pilot" }).waitFor();
    assert.match(await order(page).textContent(), /0 robots with pilot/);
    const setting = async (name) => JSON.parse(await muster("set", "clusterer", "--json"))[name];
    await page.locator("#need-skill").fill("medic");
    await page.locator("#need-team").selectOption(firstTeam);
    await page.locator("#need-soft").check();
    await page.locator("#need-add").click();
    await confirm(page);
    await page.locator("#needs li", { hasText: "medic" }).waitFor();
    assert.deepEqual((await setting("needs")).map((need) => [need.skill, need.team, need.per_team.min, need.soft]), [["medic", firstTeam, 1, true]]);
    await page.locator("#needs button").first().click();
    await confirm(page);
    await until(page, () => document.querySelectorAll("#needs li").length === 0);
    assert.deepEqual(await setting("needs"), []);
    await page.locator("#limit-team").selectOption(firstTeam);
    await page.locator("#limit-max").fill("8");
    await page.locator("#limits-set").click();
    await confirm(page);
    await until(page, (team) => document.getElementById("limits-now").textContent.includes(`${team}: – to 8`), firstTeam);
    assert.deepEqual(await setting("team_size"), { [firstTeam]: { min: null, max: 8 } });
    await page.locator("#limit-max").fill("");
    await page.locator("#limits-set").click();
    await confirm(page);
    await until(page, (team) => !document.getElementById("limits-now").textContent.includes(team), firstTeam);

    step("a range of numbers of teams, and the one that the relations show");
    await page.getByLabel("a range").check();
    await page.locator("#count-from").fill("3");
    await page.locator("#count-to").fill("4");
    await page.locator("#count-set").click();
    await confirm(page);
    await until(page, () => document.getElementById("count-now").textContent === "3 to 4");
    assert.deepEqual(await setting("teams"), { from: 3, to: 4 });
    await page.getByLabel("as the relations show").check();
    await page.locator("#count-set").click();
    await confirm(page);
    await until(page, () => document.getElementById("count-now").textContent === "auto");
    assert.equal(await setting("teams"), "auto");
    await page.getByLabel("exactly").check();
    await page.locator("#count-one").fill("3");
    await page.locator("#count-set").click();
    await confirm(page);
    await until(page, () => document.getElementById("count-now").textContent === "3");
    await until(page, () => window.muster.state.teams.teams.length === 3);

    step("what if: beside the present division, rejected, then accepted and taken back");
    /** Waits for a proposal about so many things. @param {number} count */
    const proposed = async (count) => {
        await until(page, (count) => {
            const { asked, proposal, isAsking } = window.muster.state.whatIf;
            return !isAsking && proposal?.division && Object.keys(asked).length === count && Object.keys(proposal.asked).length === count;
        }, count);
        await page.locator("#if-teams").waitFor();
    };
    await page.locator("#count-one").fill("2");
    await page.locator("#if-count").click();
    await proposed(1);
    // The planner says what `muster propose` shows, and nothing has changed.
    const proposals = (await muster("propose", "list", "--json", "--operator", "kim")).trim().split("\n").map((line) => JSON.parse(line));
    assert.deepEqual(proposals.map((one) => [one.asked, one.division.teams.length]), [[{ teams: 2 }, 2]]);
    assert.equal(await setting("teams"), 3);
    const moved = Number(/^(\d+) robot/.exec(await page.locator("#if-moved").textContent())[1]);
    assert.equal(moved, proposals[0].division.moves.length);
    assert.equal(await page.locator("#if-moves li").count(), moved);
    assert.match(await page.locator("#if-quality tbody tr").first().textContent(), /[+-]?0\.\d{3}/);
    await page.locator("#if-map").click();
    await page.locator(".watermark", { hasText: "WHAT IF" }).waitFor();
    await picture(page, "what-if");
    await axe(page, "what if");
    await page.locator("#if-reject").click();
    await until(page, () => !document.getElementById("if-teams"));
    while (!/no open proposals/.test(await muster("propose", "list", "--operator", "kim"))) await page.waitForTimeout(200);
    // Weights and limits go along, and a robot that is selected is left out.
    await page.locator("#weight-spatial").focus();
    for (let press = 0; press < 20; press++) await page.keyboard.press("ArrowRight");
    await page.locator("#if-weights").click();
    await page.locator("#limit-team").selectOption("");
    await page.locator("#limit-max").fill("8");
    await page.locator("#if-limits").click();
    await page.evaluate((robot) => window.muster.select(robot), robots[1]);
    await page.locator("#if-without").click();
    await until(page, () => document.querySelectorAll("#if-asked li").length === 3);
    await page.locator("#if-count").click();
    await proposed(4);
    await page.locator("#if-accept").click();
    await confirm(page);
    await page.locator("#orders li[data-order=done]", { hasText: "proposal" }).waitFor();
    assert.deepEqual([await setting("teams"), await setting("size")], [2, { min: null, max: 8 }]);
    const reserved = (await muster("wish", "list", "--json")).trim().split("\n").map((line) => JSON.parse(line));
    assert.deepEqual(reserved.map((one) => [one.operator, one.wish.kind, one.wish.robots]), [["kim", "reserve", [robots[1]]]]);
    await until(page, () => window.muster.state.teams.teams.length === 2);
    await page.getByRole("button", { name: /^Undo proposal/ }).click();
    await confirm(page);
    await until(page, () => document.getElementById("count-now").textContent === "3");
    await until(page, () => !document.querySelector("#wishes li[data-state=active]"));
    assert.deepEqual([await setting("teams"), await setting("size")], [3, { min: null, max: null }]);
    await page.locator("#limit-max").fill("");
    // What the loss of one robot would do, from its drawer.
    await page.evaluate((robot) => window.muster.select(robot), robots[1]);
    await page.locator("#if-lost").click();
    await page.locator("#if-asked li", { hasText: `without ${robots[1]}` }).waitFor();
    await proposed(1);
    await page.locator("#if-reject").click();
    await until(page, () => !document.getElementById("if-teams"));
    // What nothing satisfies is refused with the reason.
    await page.locator("#limit-max").fill("2");
    await page.locator("#if-limits").click();
    await page.locator("#if-problem").waitFor();
    assert.match(await page.locator("#if-problem").textContent(), /size/);
    await page.locator("#limit-max").fill("");
    await page.locator("#if-asked button").first().click();
    await until(page, () => window.muster.state.teams.teams.length === 3);
    // A need: five robots are medics, and each of the three teams is to have one.
    await page.locator("#need-skill").fill("medic");
    await page.locator("#need-min").fill("1");
    await page.locator("#need-team").selectOption("");
    await page.locator("#need-soft").uncheck();
    await page.locator("#if-needs").click();
    await proposed(1);
    assert.deepEqual(await setting("needs"), []);
    assert.match(await page.locator("#if-asked li").textContent(), /every team: medic, at least 1/);
    await page.locator("#if-accept").click();
    await confirm(page);
    await page.locator("#needs li", { hasText: "medic" }).waitFor();
    assert.deepEqual((await setting("needs")).map((need) => [need.skill, need.team ?? null, need.per_team.min, need.soft]), [["medic", null, 1, false]]);
    await until(page, () => {
        const { teams, robots, ground } = window.muster.state;
        const slots = robots.flatMap((one, index) => (one.skills.includes("medic") ? [ground.shorts[4 * index + 2]] : []));
        return teams.teams.every((_, slot) => slots.includes(slot));
    });
    await page.getByRole("button", { name: /^Undo proposal: every team: medic/ }).click();
    await confirm(page);
    await until(page, () => document.querySelectorAll("#needs li").length === 0);
    assert.deepEqual(await setting("needs"), []);

    step("a pin is granted and withdrawn");
    const team = await page.evaluate((robot) => {
        const { state } = window.muster;
        const slot = state.ground.shorts[4 * state.index.get(robot) + 2];
        return state.teams.teams.map((one) => one.id).filter((_, number) => number !== slot)[0];
    }, robots[0]);
    await page.evaluate((robot) => window.muster.select(robot), robots[0]);
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
    await confirm(page);
    await until(page, () => !document.querySelector("#wishes li[data-state=active]"));

    step("every other wish: granted, with its note and its end, and withdrawn");
    const other = await page.evaluate(() => window.muster.state.teams.teams.map((one) => one.id));
    for (const [kind, chosen, hasTeam] of [
        ["ban", [robots[2]], true], ["together", [robots[0], robots[2]], false], ["apart", [robots[3], robots[4]], false],
        ["lock", [], true], ["reserve", [robots[5]], false],
    ]) {
        await page.evaluate((robots) => robots.forEach((robot, number) => window.muster.select(robot, number > 0)), chosen);
        await page.locator("#wish-kind").selectOption(kind);
        if (hasTeam) await page.locator("#wish-team").selectOption(other[0]);
        await page.locator("#wish-minutes").fill("5");
        await page.locator("#wish-note").fill(`a ${kind}`);
        await page.locator("#wish-put").click();
        if (kind === "lock" || kind === "reserve" || chosen.length > 1) await confirm(page);
        await page.locator("#wishes li[data-state=active], #wishes li[data-state=waiting]").waitFor();
        const listed = (await muster("wish", "list", "--json")).trim().split("\n").map((line) => JSON.parse(line));
        assert.deepEqual(listed.map((one) => [one.wish.kind, one.wish.robots, one.wish.team ?? null, one.wish.note]),
            [[kind, [...chosen].sort(), hasTeam ? other[0] : null, `a ${kind}`]]);
        const minutes = await page.evaluate(() => {
            const { state } = window.muster;
            return (state.wishes[0].wish.expires - state.serverNow) / 60;
        });
        // By the clock of the services, although that of the browser is an hour off.
        assert.ok(minutes > 3 && minutes <= 5.1, `${minutes} minutes`);
        await page.locator("#wishes button").first().click();
        await confirm(page);
        await until(page, () => document.querySelectorAll("#wishes li[data-state=active], #wishes li[data-state=waiting]").length === 0);
    }

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
    const ages = await page.evaluate(() => window.muster.drawn.ages.sort((one, other) => one - other));
    console.log(`age of the data on the screen with ten browsers, p95: ${Math.round(1000 * ages[Math.floor(0.95 * ages.length)])} ms`);
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
    // Each leader of the chain says how long it takes, and how old its output is.
    await until(page, () => [...document.querySelectorAll("tr[data-service=clusterer] td")].some((cell) => / m?s$/.test(cell.textContent)));
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
    // The robots stand still, so that those on the map of the past are where they are now.
    await page.locator("#past", { hasText: "The map shows the positions of" }).waitFor();
    const past = await page.evaluate(async () => {
        const { placeOf, hasPlace } = await import("/frame.js");
        const { state } = window.muster;
        const place = (world, robot) => {
            const index = world.index.get(robot);
            return index === undefined || !hasPlace(world.ground, index) ? null : placeOf(world.ground, index);
        };
        const both = state.robots.map(({ robot }) => [place(state.replay.world, robot), place(state, robot)]);
        const known = both.filter(([was, is]) => was && is);
        return { count: known.length, apart: Math.max(...known.map(([was, is]) => Math.hypot(was[0] - is[0], was[1] - is[1]))) };
    });
    assert.ok(past.count >= 10 && past.apart < 2, JSON.stringify(past));
    await picture(page, "replay");
    await axe(page, "replay");
    // Where nothing was recorded, the map is empty, and does not show the present as the past.
    await page.locator("#moment").evaluate((slider) => {
        slider.min = "1000";
        slider.value = "2000";
        slider.dispatchEvent(new Event("change", { bubbles: true }));
    });
    await page.getByText("nothing was recorded until then").waitFor();
    assert.equal(await page.evaluate(() => window.muster.state.replay.world.ground.count), 0);
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
    await confirm(page);
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
    step("an image lies below the map, at a switch");
    const ground = () => viewer.evaluate(() => {
        const canvas = document.querySelector("canvas.grid");
        const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        let green = 0;
        for (let at = 0; at < data.length; at += 4) green += data[at + 1] > 200 && data[at] < 50 && data[at + 3] > 200 ? 1 : 0;
        return green;
    });
    await until(viewer, () => window.muster.state.hello.image?.east === 1000);
    await viewer.waitForTimeout(1000);
    assert.ok(await ground() > 10_000);
    await picture(viewer, "image");
    await viewer.locator("#image").click();
    assert.equal(await ground(), 0);
    await viewer.locator("#image").click();
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
});
