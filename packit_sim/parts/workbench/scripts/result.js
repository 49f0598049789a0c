// The result next to the box: its files, its parts with their locks, and its numbers.
import { attempt, element, get, swatch } from "./page.js";
import { reset, toggle } from "./hand.js";
import { boxOf, colorOf, point, show, shown } from "./view.js";

let result = null;
let packing = ""; // its key
let poll = () => {};

export const hasResult = () => result !== null;
export const canLock = () => result !== null && result["can lock"];
export const rows = () => [...get("locks").querySelectorAll("li")];

export function buildResult(onPoll) {
  poll = onPoll;
  get("number").addEventListener("change", showBox);
  get("coloring").addEventListener("change", () => {
    rows().forEach((row, n) => { row.querySelector(".swatch").style.background = colorOf(n); });
  });
}

export function showResult(found, key) {
  [result, packing] = [found, key];
  const number = get("number");
  const before = number.value;
  number.replaceChildren(...found.boxes.map((box, n) => element("option", `${n + 1}: ${box.name}`, { value: n })));
  number.value = Number(before) < found.boxes.length ? before || "0" : "0";
  get("choice").hidden = found.boxes.length < 2;
  get("result").hidden = false;
  const links = found.downloads.map((name) => element("a", name, { href: `/files/${encodeURIComponent(name)}`, download: name }));
  if (links.length) links.unshift(element("a", "all files (.zip)", { href: "/packing.zip", download: "packing.zip", className: "all" }));
  get("downloads").replaceChildren(...links);
  get("write").hidden = links.length > 0;
  get("left").replaceChildren(...found["left out"].map((text) => element("li", `left out: ${text}`)));
  const words = [...found.problems.map((text) => `problem: ${text}`), ...found.notes];
  get("notes").replaceChildren(...words.map((text) => element("li", text)));
  get("summary").tBodies[0].replaceChildren(...Object.entries(found.summary).map(([name, value]) =>
    element("tr", null, {}, element("th", name, { scope: "row" }), element("td", value, { className: "text" }))));
  showBox();
}

function showBox() {
  show(result, Number(get("number").value));
  get("locks").querySelector("ol").replaceChildren(...boxOf().parts.map(rowOf));
  reset(packing);
}

function rowOf(name, part) {
  const row = element("li");
  const box = element("input", null, { type: "checkbox", checked: shown.locked.has(part), disabled: !canLock() });
  box.setAttribute("aria-label", `Lock part ${part + 1}, ${name}`);
  box.addEventListener("change", () => lock(part, box.checked));
  const move = element("button", "move", { type: "button", className: "plain" });
  move.setAttribute("aria-label", `Move part ${part + 1}, ${name}, by hand`);
  move.addEventListener("click", () => toggle(true, part));
  for (const [event, value] of [["pointerenter", part], ["pointerleave", null]]) row.addEventListener(event, () => point(value));
  for (const each of [box, move]) {
    each.addEventListener("focus", () => point(part));
    each.addEventListener("blur", () => point(null));
  }
  row.append(element("label", null, {}, box, swatch(colorOf(part)), name), move);
  return row;
}

export async function lock(part, isLocked) {
  await attempt("/lock", { part, locked: isLocked });
  await poll();
}

export function showLocks(numbers) {
  shown.locked = new Set(numbers);
  rows().forEach((row, n) => { row.querySelector("input").checked = shown.locked.has(n); });
}
