// The scripts of the page without a browser.
//
//   node script.mjs FOLDER_OF_THE_SCRIPTS TEST

import assert from "node:assert/strict";
import { pathToFileURL } from "node:url";

const [, , folder, name] = process.argv;

/** What a browser has and Node has not. The one socket is the last that was opened. */
class Socket {
    static OPEN = 1;
    static last = null;
    readyState = 1;
    sent = [];

    constructor() {
        Socket.last = this;
    }

    send(text) {
        this.sent.push(JSON.parse(text));
    }

    /** Answers the last command. */
    answer(reply) {
        const { id } = this.sent.findLast((one) => one.command).command;
        this.onmessage({ data: JSON.stringify({ topic: "reply", data: { id, ...reply } }) });
    }
}
Object.assign(globalThis, {
    window: globalThis, document: { hidden: false }, location: { protocol: "http:", host: "console" }, WebSocket: Socket,
    fetch: async () => ({ status: 200, json: async () => ({ token: false }) }),
});

const load = (file) => import(pathToFileURL(`${folder}/${file}`));

const tests = {
    async orders() {
        const { command, connect } = await load("link.js");
        connect(() => {});
        while (!Socket.last) await new Promise((resolve) => setTimeout(resolve));
        Socket.last.onopen();
        const undo = [{ service: "clusterer", action: { set: { teams: 2 } } }];
        const set = () => command("teams = 3", "clusterer", { set: { teams: 3 } }, undo);
        for (const [reply, ...wanted] of [
            [{ answer: {} }, "done", "", undo],
            [{ answer: null }, "done", "", undo],
            [{ unstored: "the disk is full" }, "done", "the disk is full", undo],
            [{ refused: "too few" }, "refused", "too few", []],
            [{ unavailable: "it starts" }, "refused", "it starts", []],
            [{ unknown: "no answer" }, "unknown", "no answer", []],
        ]) {
            const pending = set();
            Socket.last.answer(reply);
            const { state, reason, undo } = await pending;
            assert.deepEqual([state, reason, undo], wanted, JSON.stringify(reply));
        }
        const pending = set();
        Socket.last.onclose();
        assert.equal((await pending).state, "unknown");
        Socket.last.readyState = 3;
        assert.equal((await set()).state, "refused");
    },

    async proposals() {
        const { undoOf } = await load("whatif.js");
        const replaces = { clusterer: { teams: 2 } };
        const proposal = { id: "page-1", asked: { teams: 3, without: ["r7"] }, division: { replaces } };
        const applied = [{ service: "clusterer", reserve: { id: "propose-page-1", robots: ["r7"] } }, { service: "clusterer", set: { teams: 3 } }];
        const wanted = [
            { service: "clusterer", action: { set: { teams: 2 } } },
            { service: "clusterer", action: { withdraw: { id: "propose-page-1" } } },
        ];
        assert.deepEqual(undoOf(proposal, applied), wanted);
        assert.deepEqual(undoOf(proposal, null), wanted);
        assert.deepEqual(undoOf({ ...proposal, asked: { teams: 3 } }, null), wanted.slice(0, 1));
    },

    async wishes() {
        const { wishId } = await load("control.js");
        assert.equal(wishId("pin", ["r7"], "t2"), "pin-r7-t2");
        assert.equal(wishId("apart", ["r1", "r2", "r3", "r4"], null), "apart-r1-r2-r3-r4");
        assert.equal(wishId("lock", [], "t2"), "lock-t2");
        const robots = Array.from({ length: 64 }, (_, number) => `r${number}`);
        const long = `scout-${"x".repeat(58)}`;
        const all = [
            wishId("apart", robots, null), wishId("apart", robots.slice(0, 63), null), wishId("apart", [...robots.slice(0, 63), "r9999"], null),
            wishId("pin", robots, "t1"), wishId("pin", robots, "t2"), wishId("pin", [long], "t1"), wishId("pin", [long], "t2"),
        ];
        assert.equal(new Set(all).size, all.length, all.join(" "));
        for (const id of all) assert.match(id, /^[a-z0-9-]{1,64}$/);
        // As `muster wish` names it.
        assert.equal(wishId("apart", ["a".repeat(50)], null), `apart-${"a".repeat(42)}-6296451f`);
    },

    async problems() {
        const { receive, state } = await load("state.js");
        const shown = () => [...state.problems.values()];
        receive({ topic: "alerts", problem: "alerts is too long" });
        receive({ topic: "teams", data: { teams: [] } });
        assert.deepEqual(shown(), ["alerts is too long"]);
        receive({ topic: "alerts", data: { open: [] } });
        assert.deepEqual(shown(), []);
        receive({ topic: "problem", data: "unknown field" });
        assert.deepEqual(shown(), ["unknown field"]);
        receive({ topic: "hello", data: {} });
        assert.deepEqual(shown(), []);
    },
};

await tests[name]();
// The page would connect again for ever.
process.exit(0);
