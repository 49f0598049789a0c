// The boxes of the order: each has sides, or is a cylinder, a container with a name, or a mesh file.
import { choice, element, get } from "./page.js";

const KINDS = { box: "Box", cylinder: "Cylinder", named: "By name", file: "Mesh file" };
const SIDES = {
  box: [["x", "200", "Width of the box, along x"], ["y", "150", "Depth of the box, along y"], ["z", "100", "Height of the box, along z"]],
  cylinder: [["diameter", "200", "Diameter of the cylinder"], ["height", "100", "Height of the cylinder"]],
};
const MOST = 50;

let known = []; // containers with a name, with what they are
let files = []; // those that were sent
let changed = () => {};

const rows = () => [...get("rows").children];

export async function buildBoxes(onChange) {
  changed = onChange;
  addBox();
  get("another").addEventListener("click", () => {
    addBox().querySelector("select").focus();
    changed();
  });
  known = await (await fetch("/containers")).json();
  rows().forEach((row) => fill(row, row.dataset.kind));
}

function addBox() {
  const row = element("div", null, { className: "box", role: "group" });
  const kind = choice(KINDS, "box", "What kind of box");
  kind.setAttribute("aria-describedby", "fault-box");
  const own = element("span", null, { className: "sides" });
  const count = element("input", null, { type: "number", className: "count", min: 1, step: 1, placeholder: "1" });
  count.setAttribute("aria-label", "How many of this box");
  Object.assign(count.dataset, { fault: "Choose a whole number of boxes from 1 on.", name: "box" });
  const remove = element("button", "\u00d7", { type: "button", className: "plain" });
  remove.setAttribute("aria-label", "Remove this box");
  remove.addEventListener("click", () => {
    row.remove();
    number();
    changed();
  });
  row.append(kind, own, element("label", "count ", { className: "several" }, count), remove);
  kind.addEventListener("change", () => fill(row, kind.value));
  get("rows").append(row);
  fill(row, "box");
  number();
  return row;
}

// Number the rows; the count and the button of a single one are hidden.
function number() {
  rows().forEach((row, n) => {
    row.setAttribute("aria-label", `Box ${n + 1}`);
    row.classList.toggle("single", rows().length === 1);
  });
  get("another").hidden = rows().length >= MOST;
}

function fill(row, kind) {
  const own = row.querySelector(".sides");
  const before = own.querySelector("select") && own.querySelector("select").value;
  row.dataset.kind = kind;
  row.querySelector("select").value = kind;
  if (kind in SIDES) {
    if (own.dataset.kind !== kind) own.replaceChildren(...SIDES[kind].flatMap(side));
  } else {
    const options = kind === "named" ? Object.fromEntries(known.map(([name, text]) => [name, `${name} (${text})`])) : Object.fromEntries(files.map((file) => [file.number, file.name]));
    own.replaceChildren(choice(options, before || Object.keys(options)[0] || "", kind === "named" ? "Container" : "File of the container"));
    if (!Object.keys(options).length) own.append(" send its file first");
  }
  own.dataset.kind = kind;
}

function side([name, value, label], n) {
  const input = element("input", null, { name, type: "number", min: 0, step: "any", value, required: true });
  input.setAttribute("aria-label", label);
  input.setAttribute("aria-describedby", "fault-box");
  Object.assign(input.dataset, { fault: "Each side of the box must be a number above 0.", name: "box" });
  input.addEventListener("input", () => input.setCustomValidity(Number(input.value) > 0 ? "" : "above 0"));
  return n ? [" x ", input] : [input];
}

// Offer the files that were sent as containers.
export function setBoxFiles(found) {
  files = found;
  rows().filter((row) => row.dataset.kind === "file").forEach((row) => fill(row, "file"));
}

export function boxValues(unit) {
  return rows().map((row, n) => {
    const { kind } = row.dataset;
    const values = [...row.querySelectorAll(".sides input, .sides select")].map((each) => each.value);
    const count = rows().length > 1 ? Number(row.querySelector(".count").value) : 0;
    const isNamed = rows().length > 1 && kind in SIDES;
    const own = { name: isNamed ? String.fromCharCode(65 + (n % 26)).repeat(1 + Math.floor(n / 26)) : "", count: count >= 1 ? Math.trunc(count) : null };
    if (kind === "file") return { ...own, file: Number(values[0]) || 0 };
    if (kind === "named") return { ...own, size: values[0] || "" };
    return { ...own, size: `${kind === "box" ? "" : "cylinder:"}${values.map((each) => each || "0").join("x")}${unit}` };
  });
}

export function restoreBoxes(boxes) {
  get("rows").replaceChildren();
  for (const box of boxes) {
    const row = addBox();
    const sizes = /^(cylinder:)?([-+.\de]+(?:x[-+.\de]+)+)/i.exec(box.size);
    const kind = box.file !== null ? "file" : !sizes ? "named" : sizes[1] ? "cylinder" : "box";
    fill(row, kind);
    if (sizes) row.querySelectorAll(".sides input").forEach((input, n) => { input.value = sizes[2].split("x")[n]; });
    else {
      const select = row.querySelector(".sides select");
      const value = kind === "file" ? String(box.file) : box.size;
      if (![...select.options].some((each) => each.value === value)) select.append(element("option", value, { value }));
      select.value = value;
    }
    if (box.count) row.querySelector(".count").value = box.count;
  }
}
