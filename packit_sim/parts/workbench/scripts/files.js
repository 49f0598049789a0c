// The table of the files that were sent: how many, how they may turn, and what else holds for them.
import { UNITS, attempt, choice, element, get } from "./page.js";

const TURNS = { cube: "any way up", upright: "upright", fixed: "as in the file", "yaw-8": "upright, by 45°", "flip-8": "also upside down, by 45°", free: "at any angle" };
const USES = { part: "a part to pack", fixed: "a part that is in the box already", keep_out: "a volume that stays free" };
const COUNTS = { number: "as many as the count", max: "as many as fit", fill: "as many as fit after all others" };
const FIELDS = [
  ["group", "group", "text"], ["value", "value of one", "number"], ["mass", "mass of one in g", "number"],
  ["density", "density in g/cm³", "number"], ["max_load", "may carry, in g", "number"], ["priority", "priority", "number"], ["clearance", "distance to others", "text"],
  ["max_tilt", "leans at most, in degrees", "number"], ["down", "sides that may face down, such as z- x+", "text"], ["stop", "stop of the delivery", "number"],
];

const asked = new Map(); // by the number of a file: its order
let changed = () => {};
let poll = () => {};

export function buildFiles(onChange, onPoll) {
  [changed, poll] = [onChange, onPoll];
}

export function restoreFiles(files) {
  for (const { number, ...own } of files) asked.set(number, own);
}

// Return the order of each file, as `AskedFile` has it.
export function fileValues() {
  return [...asked].map(([number, own]) => ({ number, ...own }));
}

export function showFiles(files) {
  const numbers = new Set(files.map((file) => file.number));
  for (const number of [...asked.keys()]) if (!numbers.has(number)) asked.delete(number);
  const open = new Set([...document.querySelectorAll("#files tr.more:not([hidden])")].map((row) => row.dataset.number));
  get("files").hidden = !files.length;
  get("files").tBodies[0].replaceChildren(...files.flatMap((file) => rowsOf(file, open.has(String(file.number)))));
}

function rowsOf(file, isOpen) {
  if (!asked.has(file.number)) asked.set(file.number, { count: 1, rotations: "cube", use: "part", fields: {} });
  const own = asked.get(file.number);
  const row = element("tr", null, { className: "file" });
  const details = element("tr", null, { className: "more", hidden: !isOpen, id: `more-${file.number}` });
  for (const each of [row, details]) each.dataset.number = file.number;

  const count = element("input", null, { type: "number", min: 0, max: 10000, step: 1, required: true, value: typeof own.count === "number" ? own.count : "" });
  count.setAttribute("aria-label", `How many of ${file.name}`);
  count.setAttribute("aria-describedby", `fault-file-${file.number}`);
  Object.assign(count.dataset, { fault: `How many of ${file.name}: a whole number from 0 to 10,000.`, name: `file ${file.number}` });
  count.addEventListener("input", () => {
    if (count.checkValidity()) own.count = Number(count.value);
    changed();
  });
  const turns = choice(TURNS, own.rotations, `How ${file.name} may turn`);
  turns.addEventListener("change", () => {
    own.rotations = turns.value;
    changed();
  });
  const remove = element("button", "\u00d7", { type: "button", className: "plain" });
  remove.setAttribute("aria-label", `Remove ${file.name}`);
  remove.addEventListener("click", async () => {
    asked.delete(file.number);
    await attempt("/remove", { number: file.number });
    await poll();
    changed();
  });
  const more = element("button", "more", { type: "button", className: "plain" });
  more.setAttribute("aria-label", `More about ${file.name}`);
  more.setAttribute("aria-expanded", String(isOpen));
  more.setAttribute("aria-controls", details.id);
  more.addEventListener("click", () => {
    details.hidden = !details.hidden;
    more.setAttribute("aria-expanded", String(!details.hidden));
  });

  const name = element("th", file.name, { scope: "row" }, element("small", file.parts > 1 ? `${file.parts} parts: ${file.size}` : file.size));
  if (!file["own unit"]) name.append(unitOf(file));
  name.append(more, element("p", "", { className: "fault", id: `fault-file-${file.number}`, role: "alert" }));
  row.append(name, ...[count, turns, remove].map((one) => element("td", null, {}, one)));

  const use = choice(USES, own.use, `What ${file.name} is`);
  const amount = choice(COUNTS, typeof own.count === "number" ? "number" : own.count, `How many of ${file.name} are packed`);
  const apply = () => {
    count.disabled = own.use !== "part" || typeof own.count !== "number";
    turns.disabled = own.use !== "part";
    details.querySelectorAll("label:not(.use)").forEach((label) => { label.hidden = own.use !== "part"; });
  };
  use.addEventListener("change", () => {
    own.use = use.value;
    apply();
    changed();
  });
  amount.addEventListener("change", () => {
    own.count = amount.value === "number" ? 1 : amount.value;
    count.value = amount.value === "number" ? 1 : "";
    apply();
    changed();
  });
  const cell = element("td", null, { colSpan: 4 }, element("label", "is ", { className: "use" }, use), element("label", "pack ", {}, amount));
  for (const [field, label, type] of FIELDS) {
    const input = element("input", null, { type, value: own.fields[field] || "" });
    if (type === "number") input.step = "any";
    input.setAttribute("aria-describedby", `fault-file-${file.number}`);
    input.addEventListener("input", () => {
      own.fields[field] = input.value;
      changed();
    });
    cell.append(element("label", `${label} `, {}, input));
  }
  const stack = element("input", null, { type: "checkbox", checked: own.fields.no_stack === "yes" });
  stack.addEventListener("change", () => {
    own.fields.no_stack = stack.checked ? "yes" : "";
    changed();
  });
  cell.append(element("label", null, {}, stack, " nothing may rest on it"));
  details.append(cell);
  apply();
  return [row, details];
}

// A choice of the unit in which a file is read that does not define one.
function unitOf(file) {
  const unit = choice(Object.fromEntries(UNITS.map((name) => [name, name])), file.unit, `Unit of ${file.name}`);
  unit.addEventListener("change", async () => {
    await attempt("/unit", { number: file.number, unit: unit.value });
    await poll();
  });
  return element("label", "read in ", { className: "unit" }, unit);
}
