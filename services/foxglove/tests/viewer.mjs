// A viewer of a live fleet, against real services.
//
//   node viewer.mjs ADDRESS READ_ONLY_ADDRESS TOPICS
//
// The Rust test does what a line `do …` asks for, and answers with one line of JSON.

import assert from "node:assert/strict";
import { createInterface } from "node:readline";

import { teamColor } from "../../console/web/colors.js";
import { Viewer } from "./connect.mjs";

const [, , address, readOnly, expected] = process.argv;
const lines = createInterface({ input: process.stdin })[Symbol.asyncIterator]();

/** Has the Rust test do something. @param {string[]} what */
async function act(...what) {
    console.log(`do ${JSON.stringify(what)}`);
    const { value } = await lines.next();
    return JSON.parse(value);
}

const step = (/** @type {string} */ name) => console.log(`step ${name}`);

step("every topic is offered and comes");
const viewer = new Viewer(address);
const topics = expected.split(",");
await viewer.until("all topics", () => topics.every((topic) => viewer.channels.has(topic)));
assert.deepEqual([...viewer.channels.keys()].sort(), topics.sort());
assert.equal(viewer.socket.protocol, "foxglove.sdk.v1");
assert.equal(viewer.info.name, "muster alpha");
assert.ok(viewer.info.capabilities.includes("parameters"));
// An event comes once, and only to viewers that the server knows of: until one has come, others are made.
for (let count = 0; !viewer.counts.has("/events") && count < 10; count++) {
    await act("event", String(count));
    await new Promise((resolve) => setTimeout(resolve, 2_000));
}
const missing = () => topics.filter((topic) => !viewer.counts.has(topic));
await viewer.until("messages of all topics", () => missing().length === 0, () => `${missing()} have none`);
assert.equal(viewer.channels.get("/tf").schemaName, "foxglove.FrameTransforms");
assert.equal(viewer.channels.get("/teams").schemaName, "foxglove.SceneUpdate");
const quality = viewer.newest.get("/quality");
assert.equal(quality.fleet, "alpha");
assert.equal(typeof quality.silhouette.mean, "number");
const described = JSON.parse(viewer.channels.get("/quality").schema);
assert.equal(described.properties.silhouette.properties.mean.type, "number");
assert.match(viewer.newest.get("/events").message, /^[a-z_]+: /);

step("positions are those that the robots put");
for (let round = 0; round < 5; round++) {
    await new Promise((resolve) => setTimeout(resolve, 300));
    const shown = viewer.newest.get("/tf").transforms;
    const put = await act("poses");
    assert.equal(shown.length, Object.keys(put).length);
    for (const { childFrameId, parentFrameId, translation } of shown) {
        assert.equal(parentFrameId, "map");
        const at = [translation.x, translation.y, translation.z];
        const known = put[childFrameId].some((one) => one.every((number, axis) => number === at[axis]));
        assert.ok(known, `${childFrameId} never was at ${at}`);
    }
}

step("each team is one entity in its colour, with its robots");
const teams = await act("teams");
const scene = await viewer.until("the teams", () => {
    const { entities } = viewer.newest.get("/teams");
    const named = entities.filter((one) => one.id.startsWith("team/"));
    return named.length === teams.length && named;
});
for (const { id, members } of teams) {
    const entity = scene.find((one) => one.id === `team/${id}`);
    assert.equal(entity.spheres.length, members);
    assert.equal(entity.texts[0].text, `${id} · ${members}`);
    const color = teamColor(id).map((part) => part / 255);
    assert.deepEqual([entity.spheres[0].color.r, entity.spheres[0].color.g, entity.spheres[0].color.b], color);
    assert.ok(entity.lifetime.seconds ?? entity.lifetime.sec);
}
const lines2 = viewer.newest.get("/links/spatial").entities[0].lines;
assert.ok(lines2.every((one) => one.points.length % 2 === 0 && one.points.length > 0));

step("at most ten scenes a second come");
const before = new Map(viewer.counts);
const since = Date.now();
await new Promise((resolve) => setTimeout(resolve, 3_000));
const seconds = (Date.now() - since) / 1000;
for (const topic of ["/tf", "/teams", "/links/spatial"]) {
    const count = (viewer.counts.get(topic) ?? 0) - (before.get(topic) ?? 0);
    // A few may have waited to be read when the counting began.
    assert.ok(count > 2 * seconds && count <= 10.7 * seconds + 10, `${topic}: ${count} in ${seconds} s`);
}

step("parameters are what the services have");
viewer.client.getParameters([], "all");
await viewer.until("parameters", () => viewer.parameters.has("embedder.weights"));
assert.equal(viewer.parameters.get("clusterer.teams"), 3);
const names = [...viewer.parameters.keys()];
viewer.client.subscribeParameterUpdates(names);

step("k is changed and read back on the bus");
viewer.client.setParameters([{ name: "clusterer.teams", value: 2 }], "k");
await viewer.until("the change", () => viewer.parameters.get("clusterer.teams") === 2);
assert.equal((await act("settings", "clusterer")).teams, 2);
await viewer.until("two teams", () => {
    const { entities } = viewer.newest.get("/teams");
    return entities.filter((one) => one.id.startsWith("team/")).length === 2;
});
const weights = { spatial: 0.5, connectivity: 0.25, hierarchy: 0.25 };
viewer.client.setParameters([{ name: "embedder.weights", value: weights }], "w");
await viewer.until("the weights", () => viewer.parameters.get("embedder.weights").connectivity === 0.25);
assert.deepEqual((await act("settings", "embedder")).weights, weights);

step("what the service refuses is refused with its reason");
viewer.statuses.length = 0;
viewer.client.setParameters([{ name: "clusterer.teams", value: 0 }], "bad");
const refusal = await viewer.until("a refusal", () => viewer.statuses.find((one) => one.level === 2));
assert.match(refusal.message, /teams/);
viewer.statuses.length = 0;
viewer.client.setParameters([{ name: "embedder.weights", value: { spatial: 0.5 } }], "sum");
const sum = await viewer.until("a refusal", () => viewer.statuses.find((one) => one.level === 2));
assert.match(sum.message, /must sum to 1/);
assert.deepEqual(viewer.parameters.get("embedder.weights"), weights);
assert.equal((await act("settings", "clusterer")).teams, 2);
assert.equal(viewer.parameters.get("clusterer.teams"), 2);

step("a change by another operator is shown");
await act("muster", "set", "clusterer", "teams=3");
await viewer.until("the change of another", () => viewer.parameters.get("clusterer.teams") === 3);

step("a viewer that may only look changes nothing");
const guest = new Viewer(readOnly, (topic) => topic === "/teams");
guest.client.on("open", () => guest.client.setParameters([{ name: "clusterer.teams", value: 5 }], "no"));
const refused = await guest.until("a refusal", () => guest.statuses.find((one) => one.level === 2));
assert.match(refused.message, /--allow-changes/);
assert.equal((await act("settings", "clusterer")).teams, 3);

step("a viewer that is stopped delays no other");
await act("stall");
viewer.counts.clear();
const start = Date.now();
let slowest = 0;
let last = Date.now();
let seen = 0;
while (Date.now() - start < 10_000) {
    await new Promise((resolve) => setTimeout(resolve, 10));
    const count = viewer.counts.get("/tf") ?? 0;
    if (count !== seen) {
        slowest = Math.max(slowest, Date.now() - last);
        [seen, last] = [count, Date.now()];
    }
}
console.log(`frames while another is stopped: ${seen}, longest pause ${slowest} ms`);
assert.ok(seen > 20 && slowest < 5_000, `${seen} frames, ${slowest} ms`);

step("a robot that is lost stays, grey, with its age");
const lost = await act("kill-robot");
const lostOnes = await viewer.until("the lost robot", () => {
    const entity = viewer.newest.get("/teams").entities.find((one) => one.id === "missing");
    return entity?.texts.some((text) => text.text.startsWith(`${lost} `)) && entity;
});
const grey = lostOnes.spheres[0].color;
assert.ok(grey.r === grey.g && grey.g === grey.b);
await viewer.until("no frame of it", () =>
    !viewer.newest.get("/tf").transforms.some((one) => one.childFrameId === lost));
assert.ok(viewer.newest.get("/teams").entities.some((one) => one.id === "missing"));

step("a router that is lost is said, and taken back");
await act("kill-router");
await viewer.until("the warning", () => viewer.statuses.some((one) => one.id === "link"));
let back = false;
viewer.client.on("removeStatus", ({ statusIds }) => (back ||= statusIds.includes("link")));
await act("start-router");
await viewer.until("the end of the warning", () => back);
viewer.counts.clear();
await viewer.until("frames", () => (viewer.counts.get("/tf") ?? 0) > 5);

console.log("everything holds");
process.exit(0);
