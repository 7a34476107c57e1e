// A viewer of everything that the Rust test stops: its socket is open, and nothing reads it.
//
//   node stalled.mjs ADDRESS

import { Viewer } from "./connect.mjs";

const viewer = new Viewer(process.argv[2]);
await viewer.until("scenes", () => (viewer.counts.get("/teams") ?? 0) > 2);
console.log("follows");
// What is not read is as good as a process that is stopped, and the socket's buffers fill.
await new Promise((resolve) => setTimeout(resolve, 600_000));
