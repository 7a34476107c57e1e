// How many frames of 10,000 robots a second the map draws, next to a plain Canvas 2D that draws the same dots; how large
// the page is; and, where the console has a fleet, how soon and how old the page shows it. Started by hand, on an idle
// machine:
//
//   target/debug/muster-console --serve 127.0.0.1:7480 &
//   MUSTER_WEB_PACKAGES=target/web/node_modules node services/console/tests/measure.mjs /usr/bin/chromium 127.0.0.1:7480

import { createRequire } from "node:module";
import { resolve } from "node:path";

const { chromium } = createRequire(`${resolve(process.env.MUSTER_WEB_PACKAGES)}/`)("playwright-core");
const [, , executablePath, address, count = "10000", seconds = "5"] = process.argv;
const browser = await chromium.launch({
    executablePath, args: ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"],
});
const page = await browser.newPage({ viewport: { width: 1280, height: 720 } });
await page.goto(`http://${address}/`);
const result = await page.evaluate(async ([count, seconds]) => {
    const { Painter } = await import("/gl.js");
    const { readFrame, HEAD, RECORD } = await import("/frame.js");
    const { teamColor } = await import("/colors.js");
    const { discs, SQUARE } = await import("/density.js");
    const colors = Array.from({ length: 20 }, (_, team) => teamColor(`t${team + 1}`));
    const shift = new Float32Array(2 * count).map(() => Math.random());
    /** A frame as the server sends it, a little further on each time. */
    const frameAt = (time) => {
        const buffer = new ArrayBuffer(HEAD + RECORD * count);
        const data = new DataView(buffer);
        data.setUint8(0, 1);
        data.setUint8(1, 1);
        data.setUint32(12, count, true);
        data.setFloat64(32, 0.01, true);
        for (let index = 0; index < count; index++) {
            const at = HEAD + RECORD * index;
            data.setUint16(at, 60000 * shift[2 * index] + 2000 * Math.sin(time + index), true);
            data.setUint16(at + 2, 60000 * shift[2 * index + 1] + 2000 * Math.cos(time + index), true);
            data.setUint16(at + 4, index % 20, true);
            data.setUint8(at + 6, index % 255);
        }
        return buffer;
    };
    // Ten frames, made before: what is measured is the page.
    const frames = Array.from({ length: 10 }, (_, number) => frameAt(number / 10));
    const canvas = () => {
        const made = document.createElement("canvas");
        [made.width, made.height] = [1280, 720];
        document.body.append(made);
        return made;
    };
    const measure = async (draw) => {
        let drawn = 0;
        const end = performance.now() + 1000 * seconds;
        while (performance.now() < end) {
            draw(frames[drawn % frames.length]);
            drawn++;
            await new Promise((resolve) => setTimeout(resolve));
        }
        return drawn / seconds;
    };
    const painter = new Painter(canvas());
    painter.setTeams(colors);
    const marks = new Uint8Array(count);
    const pixel = new Uint8Array(4);
    const scale = [2 / 620, 2 / 620];
    const ours = await measure((buffer) => {
        const frame = readFrame(buffer);
        painter.setRobots(frame, marks);
        painter.paint({
            frame, ends: new Float32Array(), scale, shift: [0, 0], middle: [310, 310], size: 6, alpha: 0.6, ink: [1, 1, 1], ground: [0, 0, 0],
        });
        // Waits until the card has drawn.
        painter.gl.readPixels(0, 0, 1, 1, painter.gl.RGBA, painter.gl.UNSIGNED_BYTE, pixel);
    });
    // What the page does with so many robots in the window.
    const density = await measure((buffer) => {
        const frame = readFrame(buffer);
        const made = discs(frame, marks, [0, 62000], 62000 / 720, [1280, 720]);
        painter.setRobots(made.frame, made.marks);
        painter.paint({
            frame: made.frame, ends: new Float32Array(), scale, shift: [0, 0], middle: [310, 310], size: SQUARE, sized: true,
            alpha: 1, ink: [1, 1, 1], ground: [0, 0, 0],
        });
        painter.gl.readPixels(0, 0, 1, 1, painter.gl.RGBA, painter.gl.UNSIGNED_BYTE, pixel);
    });
    const plain = canvas();
    const pen = plain.getContext("2d");
    const styles = colors.map((color) => `rgb(${color.join(" ")})`);
    const baseline = await measure((buffer) => {
        const frame = readFrame(buffer);
        pen.clearRect(0, 0, 1280, 720);
        for (let index = 0; index < frame.count; index++) {
            const x = (frame.shorts[4 * index] / 65535) * 1280;
            const y = (frame.shorts[4 * index + 1] / 65535) * 720;
            const turn = (frame.bytes[8 * index + 6] / 255) * 2 * Math.PI;
            pen.fillStyle = styles[frame.shorts[4 * index + 2]];
            pen.beginPath();
            pen.arc(x, y, 3, 0, 2 * Math.PI);
            pen.fill();
            pen.beginPath();
            pen.moveTo(x, y);
            pen.lineTo(x + 3 * Math.cos(turn), y - 3 * Math.sin(turn));
            pen.stroke();
        }
        pen.getImageData(0, 0, 1, 1);
    });
    const bytes = performance.getEntriesByType("resource").reduce((sum, one) => sum + one.encodedBodySize, 0);
    return { robots: count, dots: Math.round(ours), density: Math.round(density), baseline: Math.round(10 * baseline) / 10, times: { dots: Math.round((10 * ours) / baseline) / 10, density: Math.round((10 * density) / baseline) / 10 }, page_bytes: bytes };
}, [Number(count), Number(seconds)]);
console.log(JSON.stringify(result));
await page.close();

// The page as operators have it, if the fleet of the console has robots: how soon it shows them, how old what it shows is,
// and how often it draws.
const live = await browser.newPage({ viewport: { width: 1280, height: 720 } });
const begun = performance.now();
await live.goto(`http://${address}/`);
const shows = () => live.waitForFunction(() => window.muster?.drawn.count > 0, null, { timeout: 5_000, polling: 20 });
if (await shows().then(() => true, () => false)) {
    const first = performance.now() - begun;
    await live.waitForTimeout(3_000);
    const before = await live.evaluate(() => window.muster.drawn.count);
    await live.waitForTimeout(1_000 * Number(seconds));
    const [after, ages, robots, discs] = await live.evaluate(() => {
        const { drawn, state } = window.muster;
        return [drawn.count, drawn.ages, state.ground?.count, drawn.discs];
    });
    ages.sort((left, right) => left - right);
    const age = (share) => Math.round(1_000 * ages[Math.floor(share * (ages.length - 1))]);
    console.log(JSON.stringify({
        robots, discs, first_picture_ms: Math.round(first), frames_per_second: (after - before) / Number(seconds),
        age_ms: { p50: age(0.5), p95: age(0.95) },
    }));
}
await browser.close();
process.exit(0);
