// A viewer as others write it: the client of npm `@foxglove/ws-protocol`, and messages decoded by the schemas that the
// server advertises.

import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const packages = createRequire(`${process.env.MUSTER_WEB_PACKAGES}/`);
const load = (/** @type {string} */ name) => import(pathToFileURL(packages.resolve(name)).href);
const { FoxgloveClient } = packages("@foxglove/ws-protocol");
const { WebSocket } = packages("ws");
const { createFileRegistry, fromBinary } = await load("@bufbuild/protobuf");
const { FileDescriptorSetSchema } = await load("@bufbuild/protobuf/wkt");

/** How long anything may take, in milliseconds. */
const WITHIN = 60_000;

/** Decodes messages of a channel. @param {any} channel */
function decoder(channel) {
    if (channel.encoding === "json") return (/** @type {Uint8Array} */ bytes) => JSON.parse(new TextDecoder().decode(bytes));
    const set = fromBinary(FileDescriptorSetSchema, Buffer.from(channel.schema, "base64"));
    const message = createFileRegistry(set).getMessage(channel.schemaName);
    if (!message) throw new Error(`${channel.topic}: the schema has no ${channel.schemaName}`);
    return (/** @type {Uint8Array} */ bytes) => fromBinary(message, bytes);
}

/** Connects, and follows every topic that a filter lets through. */
export class Viewer {
    /** @type {Map<string, any>} */ channels = new Map();
    /** The newest message of each topic. @type {Map<string, any>} */ newest = new Map();
    /** How many messages of each topic came. @type {Map<string, number>} */ counts = new Map();
    /** @type {any[]} */ statuses = [];
    /** @type {Map<string, any>} */ parameters = new Map();
    /** @type {any} */ info = null;
    /** @type {Map<number, {topic: string, decode: (bytes: Uint8Array) => any}>} */ subscriptions = new Map();

    /** @param {string} address @param {(topic: string) => boolean} wants */
    constructor(address, wants = () => true) {
        this.socket = new WebSocket(`ws://${address}`, ["foxglove.sdk.v1"]);
        this.client = new FoxgloveClient({ ws: this.socket });
        this.client.on("serverInfo", (info) => (this.info = info));
        this.client.on("status", (status) => this.statuses.push(status));
        this.client.on("error", (error) => this.statuses.push({ level: 2, message: String(error) }));
        this.client.on("parameterValues", ({ parameters }) => {
            for (const { name, value } of parameters) this.parameters.set(name, value);
        });
        this.client.on("advertise", (channels) => {
            for (const channel of channels) {
                this.channels.set(channel.topic, channel);
                if (!wants(channel.topic)) continue;
                const id = this.client.subscribe(channel.id);
                this.subscriptions.set(id, { topic: channel.topic, decode: decoder(channel) });
            }
        });
        this.client.on("message", ({ subscriptionId, data }) => {
            const found = this.subscriptions.get(subscriptionId);
            if (!found) return;
            const bytes = new Uint8Array(data.buffer, data.byteOffset, data.byteLength);
            this.newest.set(found.topic, found.decode(bytes));
            this.counts.set(found.topic, (this.counts.get(found.topic) ?? 0) + 1);
        });
    }

    /**
     * Waits until something holds.
     * @param {string} what @param {() => any} holds @param {() => string} instead says what there is instead
     */
    async until(what, holds, instead = () => "") {
        const started = Date.now();
        for (;;) {
            const value = await holds();
            if (value) return value;
            if (Date.now() - started > WITHIN) throw new Error(`${what}: not within ${WITHIN} ms ${instead()}`);
            await new Promise((resolve) => setTimeout(resolve, 20));
        }
    }
}
