// Fields of the order that are generated from one table, with their values as the server reads them.
import { choice, element, get } from "./page.js";

// What numbers are possible by their kinds, and what the page says of others.
const LIMITS = {
  any: [{ min: 0 }, "Choose a number of at least 0."],
  positive: [{ min: 1e-9 }, "Choose a number above 0."],
  seconds: [{ min: 1, max: 86400, required: true }, "Choose 1 to 86,400 seconds."],
  count: [{ min: 1, step: 1 }, "Choose a whole number from 1 on."],
  angle: [{ min: 0, max: 180 }, "Choose 0 to 180 degrees."],
  share: [{ min: 0.1, max: 50 }, "Choose 0.1 to 50 percent."],
};
const GRAMS = ["g", "kg", "oz", "lb"];

const SIDES = { "z-": "the bottom, as in the file", "z+": "the top", "x-": "the left", "x+": "the right", "y-": "the front", "y+": "the back" };

// kind: length (text with a unit), seconds, flag, count, mass, angle, share, powder, select or choices; in: where it is on the page.
const FIELDS = [
  { in: "basic", name: "clearance", label: "Distance between parts", kind: "length", value: "0" },
  { in: "basic", name: "wall_clearance", label: "Distance to the walls", kind: "length", value: "0" },
  { in: "basic", name: "seconds", label: "Time in seconds", kind: "seconds", value: "30" },
  { in: "Distances", name: "clearance_z", label: "Between parts, one above the other", kind: "length", hint: "same" },
  { in: "Distances", name: "wall_sides", label: "To the sides", kind: "wall", wall: "sides", hint: "same" },
  { in: "Distances", name: "wall_floor", label: "To the floor", kind: "wall", wall: "floor", hint: "same" },
  { in: "Distances", name: "wall_top", label: "To the top", kind: "wall", wall: "top", hint: "same" },
  { in: "Rules for all parts", name: "removable", label: "each can be taken out by straight moves", kind: "flag" },
  { in: "Rules for all parts", name: "insertable", label: "each can be put in by one straight move", kind: "flag" },
  { in: "Rules for all parts", name: "separable", label: "none are linked: each can be moved out without turning", kind: "flag" },
  { in: "Rules for all parts", name: "door", label: "Parts come in through", kind: "select", choices: {
    "z+": "the top", "x-": "the left side (x-)", "x+": "the right side (x+)", "y-": "the front (y-)", "y+": "the back (y+)" } },
  { in: "Rules for all parts", name: "order", label: "in the order of a delivery: parts of later stops are not in the way", kind: "flag", on: "delivery" },
  { in: "Rules for all parts", name: "stable", label: "Most that one may move under gravity", kind: "length", isPositive: true, hint: "any" },
  { in: "How parts may turn", name: "max_tilt", label: "Most that one leans, in degrees", kind: "angle", hint: "any" },
  { in: "Sides that may face down (none: any)", name: "down", label: "", kind: "choices", isText: true, choices: SIDES },
  { in: "Boxes and limits", name: "boxes", label: "Number of boxes of each size", kind: "count", hint: "auto" },
  { in: "Boxes and limits", name: "max_mass", label: "Most mass in a box", kind: "mass", isPositive: true, hint: "any" },
  { in: "Boxes and limits", name: "max_parts", label: "Most parts in a box", kind: "count", isList: true, hint: "any" },
  { in: "Boxes and limits", name: "balance", label: "Centre of gravity off the middle, at most in %", kind: "share", hint: "any" },
  { in: "Printing in powder", name: "even", label: "spread the parts' area evenly over the height", kind: "flag" },
  { in: "Printing in powder", name: "powder", label: "Density of the loose powder in g/cm³", kind: "powder", hint: "none" },
  { in: "Printing in powder", name: "powder_refresh", label: "Fresh powder in %", kind: "refresh", hint: "20" },
  { in: "Groups", name: "groups", label: "", kind: "choices", choices: {
    together: "all of a group in one box", apart: "never two groups in one box", kit: "a group is whole in one box, or not packed" } },
];

const form = () => get("order").elements;

export function buildFields() {
  const more = new Map();
  for (const field of FIELDS) {
    let place = get(field.in);
    if (!place) {
      if (!more.has(field.in)) {
        more.set(field.in, element("fieldset", null, {}, element("legend", field.in)));
        get("more").append(more.get(field.in));
      }
      place = more.get(field.in);
    }
    place.append(...(field.kind === "choices" ? choices(field) : [labelled(field)]));
    const where = placeOf(field);
    if (!get(`fault-${where}`)) place.append(element("p", "", { className: "fault", id: `fault-${where}`, role: "alert" }));
  }
}

// The name of the setting that a field is a part of.
const placeOf = (field) => ({ wall: "wall_clearance", refresh: "powder" }[field.kind] || field.name);

function labelled(field) {
  const where = placeOf(field);
  const input = element("input", null, { name: field.name });
  input.setAttribute("aria-describedby", `fault-${where}`);
  if (field.kind === "flag") {
    input.type = "checkbox";
    return element("label", null, {}, input, ` ${field.label}`);
  }
  if (field.kind === "select") {
    const select = choice(field.choices, Object.keys(field.choices)[0], field.label);
    select.name = field.name;
    select.setAttribute("aria-describedby", `fault-${where}`);
    return element("label", `${field.label} `, {}, select);
  }
  const [limits, fault] = LIMITS[field.isPositive ? "positive" : field.kind] || LIMITS.any;
  Object.assign(input, { type: "number", step: "any", value: field.value || "", placeholder: field.hint || "", ...limits });
  Object.assign(input.dataset, { fault, name: where });
  const made = element("label", `${field.label} `, {}, input);
  if (field.kind === "mass") {
    const unit = element("select", null, { name: `${field.name}_unit` }, ...GRAMS.map((name) => element("option", name)));
    unit.setAttribute("aria-label", `Unit of: ${field.label}`);
    unit.value = "kg";
    made.append(unit);
  }
  return made;
}

function choices(field) {
  return Object.entries(field.choices).map(([value, text]) => {
    const input = element("input", null, { type: "checkbox", name: field.name, value });
    input.setAttribute("aria-describedby", `fault-${field.name}`);
    return element("label", null, {}, input, ` ${text}`);
  });
}

// The value of a number's field, or "" if it is none.
function number(name) {
  const input = form()[name];
  return input.checkValidity() ? input.value : "";
}

// Return the values of all fields, as `PackingJob` has them.
export function fieldValues() {
  const unit = form().unit.value;
  const found = {};
  const walls = [];
  for (const { name, kind, wall, value, isList, isText, on } of FIELDS) {
    if (kind === "flag") found[name] = on ? (form()[name].checked ? on : null) : form()[name].checked;
    else if (kind === "choices") {
      const chosen = [...form()[name]].filter((each) => each.checked).map((each) => each.value);
      found[name] = isText ? chosen.join(",") || null : chosen;
    } else if (kind === "select") found[name] = form()[name].value;
    else if (kind === "angle") found[name] = number(name) ? `${number(name)}deg` : null;
    else if (kind === "share") found[name] = number(name) ? [`${number(name)}%`] : [];
    else if (kind === "powder") found[name] = number(name) ? `${number(name)}:${number(`${name}_refresh`) || 20}%` : null;
    else if (kind === "refresh") continue; // with the powder
    else if (kind === "wall") walls.push([wall, number(name)]);
    else if (kind === "length") found[name] = number(name) ? number(name) + unit : value ? `0${unit}` : null;
    else if (kind === "seconds") found[name] = Number(number(name) || value);
    else if (kind === "mass") found[name] = number(name) ? [number(name) + form()[`${name}_unit`].value] : [];
    else if (isList) found[name] = number(name) ? [number(name)] : [];
    else found[name] = number(name) ? Number(number(name)) : null;
  }
  if (walls.some(([, text]) => text)) {
    const all = number("wall_clearance") || "0";
    found.wall_clearance = walls.map(([wall, text]) => `${wall}=${text || all}${unit}`).join(",");
  }
  return found;
}

const plain = (text) => (/^[-+.\d]+(e[-+]?\d+)?/i.exec(text || "") || [""])[0];

export function restoreFields(job) {
  const walls = Object.fromEntries((job.wall_clearance.includes("=") ? job.wall_clearance : "").split(",").map((each) => each.split("=")));
  for (const { name, kind, wall, isList, choices: known, on } of FIELDS) {
    const field = form()[name];
    if (kind === "flag") field.checked = on ? job[name] === on : job[name];
    else if (kind === "choices") field.forEach((each) => { each.checked = (job[name] || []).includes(each.value); });
    else if (kind === "select") field.value = job[name];
    else if (kind === "refresh") field.value = plain((job.powder || "").split(":")[1]);
    else if (kind === "wall") field.value = plain(walls[wall]);
    else if (kind === "share") field.value = plain(job[name][0]);
    else if (kind === "mass") {
      field.value = plain(job[name][0]);
      if (job[name].length) form()[`${name}_unit`].value = job[name][0].slice(plain(job[name][0]).length);
    } else if (isList) field.value = job[name][0] || "";
    else if (name === "wall_clearance") field.value = walls.sides === undefined ? plain(job[name]) : "0";
    else field.value = job[name] === null ? "" : plain(String(job[name]));
    const place = field.closest ? field.closest("details") : null;
    const usual = known ? Object.keys(known)[0] : field.defaultValue || "";
    if (place && field.value !== usual && field.type !== "checkbox") place.open = true;
  }
}
