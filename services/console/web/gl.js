// Points and lines on the graphics card: one batched draw each. A frame of the server is uploaded as it came.

import { RECORD } from "./frame.js";

/** Most teams with a colour; as many as a fleet may have. */
const MAX_TEAMS = 1024;

const POINTS = `#version 300 es
precision highp float;
layout(location = 0) in vec2 cell;
layout(location = 1) in float slot;
layout(location = 2) in float heading;
layout(location = 3) in float flags;
layout(location = 4) in float mark;
uniform vec2 origin, scale, shift;
uniform float width, size, lightest, sized;
uniform sampler2D teams;
out vec3 color;
out float angle;
flat out int state, chosen;
out float faint;
flat out float across;
void main() {
    bool placed = cell.x < 65534.5;
    vec2 at = (origin + cell * width) * scale + shift;
    gl_Position = placed ? vec4(at, 0.0, 1.0) : vec4(9.0, 9.0, 0.0, 1.0);
    state = int(flags);
    chosen = int(mark) & 1;
    faint = (int(mark) & 2) != 0 ? 0.12 : 1.0;
    bool lead = (state & 16) != 0;
    across = size * (lead ? 1.35 : 1.0) * (chosen == 1 ? 1.25 : 1.0);
    // A disc of a map of density has its size in the upper six bits of the mark.
    if (sized > 0.5) across = size * (0.25 + 0.75 * float(int(mark) >> 2) / 63.0);
    gl_PointSize = across;
    color = slot > 65534.5 ? vec3(lightest) : texelFetch(teams, ivec2(int(slot) % ${MAX_TEAMS}, 0), 0).rgb;
    if ((state & 3) != 0) color = vec3(0.55);
    angle = heading > 254.5 ? -1.0 : heading / 255.0 * 6.2831853;
}`;

const DOT = `#version 300 es
precision highp float;
in vec3 color;
in float angle;
flat in int state, chosen;
in float faint;
flat in float across;
uniform float alpha;
uniform vec3 ink, ground;
out vec4 pixel;
void main() {
    vec2 at = (gl_PointCoord - 0.5) * 2.0;
    float far = length(at);
    if (far > 1.0) discard;
    vec3 fill = color;
    float shown = alpha;
    if (across > 7.0) {
        float rim = 1.0 - 3.6 / across;
        float turn = atan(at.y, at.x);
        if (far > rim) {
            // The outline says the state: white-on-dark for a choice, dashes for silence, dots for what is provisional.
            fill = color * 0.55;
            if ((state & 8) != 0 && fract(turn * 1.9) < 0.5) fill = ink;
            if ((state & 3) != 0) fill = fract(turn * 1.2732) < 0.5 ? ink : ground;
            if ((state & 4) != 0) fill = ink;
            if (chosen == 1) fill = ink;
        } else if ((state & 2) != 0) {
            // Lost: a cross.
            if (min(abs(at.x - at.y), abs(at.x + at.y)) < 2.4 / across) fill = ground;
        } else if (angle >= 0.0 && across > 9.0) {
            vec2 way = vec2(cos(angle), -sin(angle));
            float along = dot(at, way);
            if (along > 0.0 && length(at - way * along) < 2.2 / across) fill = ground;
        }
        if ((state & 16) != 0 && far < 0.28) fill = ink;
    } else if (chosen == 1) {
        fill = ink;
    }
    pixel = vec4(fill, shown * faint);
}`;

// A disc of a map of density: the same vertices, and much less for each pixel than a dot with its outline.
const DISC = `#version 300 es
precision highp float;
in vec3 color;
flat in int chosen;
uniform vec3 ink;
out vec4 pixel;
void main() {
    vec2 at = gl_PointCoord - 0.5;
    if (dot(at, at) > 0.25) discard;
    pixel = vec4(chosen == 1 ? ink : color, 1.0);
}`;

const ENDS = `#version 300 es
precision highp float;
layout(location = 0) in vec3 at;
uniform vec2 scale, shift;
out float weight;
void main() {
    gl_Position = vec4(at.xy * scale + shift, 0.0, 1.0);
    weight = at.z;
}`;

const LINE = `#version 300 es
precision highp float;
in float weight;
uniform vec3 ink;
out vec4 pixel;
void main() { pixel = vec4(ink, 0.12 + 0.5 * weight); }`;

export class Painter {
    /** @param {HTMLCanvasElement} canvas */
    constructor(canvas) {
        const gl = canvas.getContext("webgl2", { antialias: false, alpha: true, premultipliedAlpha: false, powerPreference: "high-performance" });
        if (!gl) throw new Error("this browser has no WebGL2, which the map is drawn with");
        this.gl = gl;
        this.points = this.#program(POINTS, DOT);
        this.discs = this.#program(POINTS, DISC);
        this.lines = this.#program(ENDS, LINE);
        this.records = /** @type {WebGLBuffer} */ (gl.createBuffer());
        this.marks = /** @type {WebGLBuffer} */ (gl.createBuffer());
        this.ends = /** @type {WebGLBuffer} */ (gl.createBuffer());
        this.pointArray = this.#pointArray();
        this.lineArray = gl.createVertexArray();
        gl.bindVertexArray(this.lineArray);
        gl.bindBuffer(gl.ARRAY_BUFFER, this.ends);
        gl.enableVertexAttribArray(0);
        gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 12, 0);
        gl.bindVertexArray(null);
        this.teams = gl.createTexture();
        gl.bindTexture(gl.TEXTURE_2D, this.teams);
        for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
            gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
        }
        this.setTeams([]);
        gl.enable(gl.BLEND);
        gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    }

    /** @param {string} vertex @param {string} fragment */
    #program(vertex, fragment) {
        const { gl } = this;
        const program = gl.createProgram();
        for (const [kind, text] of /** @type {[number, string][]} */ ([
            [gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment],
        ])) {
            const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
            gl.shaderSource(shader, text);
            gl.compileShader(shader);
            gl.attachShader(program, shader);
        }
        gl.linkProgram(program);
        if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
            throw new Error(gl.getProgramInfoLog(program) ?? "a shader does not link");
        }
        return program;
    }

    #pointArray() {
        const { gl } = this;
        const array = gl.createVertexArray();
        gl.bindVertexArray(array);
        gl.bindBuffer(gl.ARRAY_BUFFER, this.records);
        for (const [place, length, kind, from] of [
            [0, 2, gl.UNSIGNED_SHORT, 0], [1, 1, gl.UNSIGNED_SHORT, 4], [2, 1, gl.UNSIGNED_BYTE, 6],
            [3, 1, gl.UNSIGNED_BYTE, 7],
        ]) {
            gl.enableVertexAttribArray(place);
            gl.vertexAttribPointer(place, length, kind, false, RECORD, from);
        }
        gl.bindBuffer(gl.ARRAY_BUFFER, this.marks);
        gl.enableVertexAttribArray(4);
        gl.vertexAttribPointer(4, 1, gl.UNSIGNED_BYTE, false, 1, 0);
        gl.bindVertexArray(null);
        return array;
    }

    /** @param {[number, number, number][]} colors by slot */
    setTeams(colors) {
        const { gl } = this;
        const bytes = new Uint8Array(4 * MAX_TEAMS).fill(255);
        colors.slice(0, MAX_TEAMS).forEach((color, slot) => bytes.set(color, 4 * slot));
        gl.bindTexture(gl.TEXTURE_2D, this.teams);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, MAX_TEAMS, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    }

    /** @param {import("./frame.js").Frame} frame @param {Uint8Array} marks one per robot */
    setRobots(frame, marks) {
        const { gl } = this;
        gl.bindBuffer(gl.ARRAY_BUFFER, this.records);
        gl.bufferData(gl.ARRAY_BUFFER, frame.bytes, gl.STREAM_DRAW);
        gl.bindBuffer(gl.ARRAY_BUFFER, this.marks);
        gl.bufferData(gl.ARRAY_BUFFER, marks, gl.STREAM_DRAW);
    }

    /**
     * @param {object} what
     * @param {import("./frame.js").Frame | null} what.frame
     * @param {Float32Array} what.ends x, y and weight of each end of each line
     * @param {[number, number]} what.scale @param {[number, number]} what.shift to the corners of the canvas at ±1
     * @param {[number, number]} what.middle what lies in the middle; lines count from there
     * @param {number} what.size of a point in pixels, the largest if `sized` @param {number} what.alpha
     * @param {boolean} [what.sized] whether the marks have a size for each point
     * @param {[number, number, number]} what.ink @param {[number, number, number]} what.ground
     */
    paint({ frame, ends, scale, shift, middle, size, alpha, sized = false, ink, ground }) {
        const { gl } = this;
        gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
        gl.clearColor(ground[0], ground[1], ground[2], 0);
        gl.clear(gl.COLOR_BUFFER_BIT);
        if (ends.length) {
            gl.useProgram(this.lines);
            this.#set(this.lines, { scale, shift, ink });
            gl.bindBuffer(gl.ARRAY_BUFFER, this.ends);
            gl.bufferData(gl.ARRAY_BUFFER, ends, gl.STREAM_DRAW);
            gl.bindVertexArray(this.lineArray);
            gl.drawArrays(gl.LINES, 0, ends.length / 3);
        }
        if (frame) {
            const program = sized ? this.discs : this.points;
            gl.useProgram(program);
            // The card counts in single precision: what is far from the origin is brought near before.
            const origin = [frame.origin[0] - middle[0], frame.origin[1] - middle[1]];
            this.#set(program, {
                origin, scale, shift, width: frame.cell, size, alpha, sized: Number(sized), ink, ground, lightest: 0.75,
            });
            gl.bindTexture(gl.TEXTURE_2D, this.teams);
            gl.bindVertexArray(this.pointArray);
            gl.drawArrays(gl.POINTS, 0, frame.count);
        }
        gl.bindVertexArray(null);
    }

    /** @param {WebGLProgram} program @param {Record<string, number | number[]>} values */
    #set(program, values) {
        const { gl } = this;
        for (const [name, value] of Object.entries(values)) {
            const place = gl.getUniformLocation(program, name);
            if (!place) continue;
            if (typeof value === "number") gl.uniform1f(place, value);
            else if (value.length === 2) gl.uniform2fv(place, value);
            else gl.uniform3fv(place, value);
        }
    }
}
