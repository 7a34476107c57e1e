// The table of teams, who is missing, and the filter.

import { teamStyle } from "./colors.js";
import { age, counted, fixed } from "./format.js";
import { flagsOf } from "./frame.js";
import { centre, draw, frames, passes, STATES } from "./map.js";
import { sendView } from "./link.js";
import { changed, now, select, state, teamOf } from "./state.js";
import { h } from "./vendor/preact.js";

/** Most robots that the list names; the filter finds the others. */
const MAX_LISTED = 200;

/** @param {string} robot */
export function open(robot) {
    select(robot);
    centre(robot);
    sendView();
}

/** A robot that can be chosen. @param {string} robot @param {string} [more] */
export const robotLink = (robot, more = "") =>
    h("button", { class: "link", type: "button", onClick: () => open(robot) }, robot, more);

/** A team with its colour. @param {string | null | undefined} id */
export const teamName = (id) =>
    id ? h("span", { class: "team" }, h("span", { class: "dot", style: { background: teamStyle(id) } }), id) : "–";

/** @param {string} team */
function selectTeam(team) {
    state.selected = new Set(state.robots.filter((_, index) => teamOf(index) === team).map((one) => one.robot));
    state.opened = "";
    changed();
    sendView();
    draw();
}

function row(/** @type {any} */ team) {
    const audit = state.audit?.teams?.find((/** @type {any} */ one) => one.team === team.id);
    const alerts = (state.alerts?.open ?? []).filter((/** @type {any} */ one) => one.team === team.id).length;
    const radio = audit?.radio;
    const skills = (audit?.skills ?? []).map((/** @type {any} */ one) =>
        `${one.skill} ${one.robots}${one.lacking ? ` (lacks ${one.lacking})` : one.spare ? ` (${one.spare} spare)` : ""}`);
    return h("tr", { key: team.id, "data-team": team.id },
        h("th", { scope: "row" }, h("button", { class: "link", type: "button", onClick: () => selectTeam(team.id) }, teamName(team.id))),
        h("td", { class: "number" }, team.members),
        h("td", { class: "number" }, fixed(audit?.silhouette)),
        h("td", {}, audit?.least ? [fixed(audit.least.silhouette), " ", robotLink(audit.least.robot)] : "–"),
        h("td", {}, robotLink(team.leader), audit?.leader_stale ? " (silent)" : ""),
        h("td", {}, radio ? (radio.parts > 1 ? `${radio.parts} parts` : "whole") + (radio.cut_robot_count ? `, ${counted(radio.cut_robot_count, "cut")}` : "") : "–"),
        h("td", {}, skills.join(", ") || "–"),
        h("td", { class: "number" }, audit?.stale ?? "–"),
        h("td", { class: "number" }, alerts || "–"));
}

function missing() {
    const { count, robots } = state.lost;
    if (!count) return null;
    return h("section", { "aria-labelledby": "missing" },
        h("h2", { id: "missing" }, `Missing: ${counted(count, "robot")}`),
        state.link ? null : h("p", { class: "warn" }, "The link to the router is lost: the state of these robots is not known."),
        h("div", { class: "scroll", tabIndex: 0, role: "group", "aria-label": "Table" }, h("table", { id: "missing-robots" },
            h("thead", {}, h("tr", {}, ["robot", "is", "last seen", "team"].map((name) => h("th", { scope: "col" }, name)))),
            h("tbody", {}, robots.slice(0, MAX_LISTED).map((/** @type {any} */ one) => h("tr", { key: one.robot, "data-robot": one.robot },
                h("th", { scope: "row" }, robotLink(one.robot)),
                h("td", {}, one.state === "lost" ? "lost" : "silent"),
                h("td", {}, `${age(now() - one.last_seen)} ago`),
                h("td", {}, teamName(one.team))))))));
}

/** @param {string} label @param {string} field @param {string[]} values @param {string} any */
function choice(label, field, values, any) {
    const filter = /** @type {any} */ (state.filter);
    return h("label", {}, label, h("select", {
        id: `filter-${field}`,
        value: filter[field],
        onChange: (/** @type {any} */ event) => {
            filter[field] = event.target.value;
            changed();
            draw();
        },
    }, h("option", { value: "" }, any), values.map((value) => h("option", { value, selected: filter[field] === value }, value))));
}

function filter() {
    const roles = [...new Set(state.robots.map((one) => one.role).filter(Boolean))].sort();
    const skills = [...new Set(state.robots.flatMap((one) => one.skills))].sort();
    const teams = (state.teams?.teams ?? []).map((/** @type {any} */ team) => team.id).concat("none");
    const places = frames();
    return h("form", { class: "filter", role: "search", onSubmit: (/** @type {Event} */ event) => event.preventDefault() },
        h("label", {}, "Name", h("input", {
            id: "search", type: "search", value: state.filter.text, autocomplete: "off",
            onInput: (/** @type {any} */ event) => {
                state.filter.text = event.target.value.trim();
                changed();
                draw();
            },
        })),
        choice("Team", "team", teams, "all"),
        choice("Role", "role", /** @type {string[]} */ (roles), "all"),
        choice("Skill", "skill", skills, "all"),
        places.length > 1 || state.filter.frame ? choice("Frame", "frame", places, "all") : null,
        choice("State", "state", Object.keys(STATES), "all"));
}

function found() {
    if (!Object.values(state.filter).some(Boolean)) return null;
    const frame = state.ground;
    const list = state.robots.filter((one, index) => passes(one, teamOf(index), frame && index < frame.count ? flagsOf(frame, index) : 0));
    return h("section", { "aria-labelledby": "found" },
        h("h2", { id: "found" }, `Found: ${counted(list.length, "robot")}`),
        h("button", { type: "button", onClick: () => {
            state.selected = new Set(list.map((one) => one.robot));
            state.opened = "";
            changed();
            sendView();
            draw();
        } }, "Select all"),
        h("ul", { class: "robots" }, list.slice(0, MAX_LISTED).map((one) => h("li", { key: one.robot }, robotLink(one.robot)))));
}

export function Teams() {
    const { teams } = state;
    if (!teams) return h("p", {}, "No division has arrived yet.");
    const names = ["team", "robots", "mean fit", "least fit", "leader", "radio", "skills", "silent", "alerts"];
    const decided = teams.considered?.length ? "chosen by the relations" : "as was asked for";
    return h("div", {},
        filter(), found(), missing(),
        h("h2", { id: "teams-title" }, `${counted(teams.teams.length, "team")}, ${decided}`),
        teams.conflict && h("p", { class: "warn", role: "status" }, teams.conflict),
        h("div", { class: "scroll", tabIndex: 0, role: "group", "aria-label": "Table" }, h("table", { id: "teams", "aria-labelledby": "teams-title" },
            h("thead", {}, h("tr", {}, names.map((name) => h("th", { scope: "col" }, name)))),
            h("tbody", {}, teams.teams.map(row)))),
        h("p", {}, `Without a team: ${counted(teams.unassigned, "robot")}. `,
            `Provisional: ${teams.provisional}. Held in their team: ${teams.held}.`),
        teams.needs?.length ? h("p", {}, "Needs: ", teams.needs.map((/** @type {any} */ need) =>
            `${need.team} ${need.skill} ${need.have}/${need.min}`).join(", ")) : null);
}
