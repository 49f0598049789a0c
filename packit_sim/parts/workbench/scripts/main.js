// The workbench: sends files and orders, and shows what the server has.
import { attempt, element, get, say, send } from "./page.js";
import { boxValues, buildBoxes, restoreBoxes, setBoxFiles } from "./boxes.js";
import { goToFault, ownFaults, showFaults } from "./faults.js";
import { buildFields, fieldValues, restoreFields } from "./fields.js";
import { buildFiles, fileValues, restoreFiles, showFiles } from "./files.js";
import { buildHand, enable, isMoving, refused } from "./hand.js";
import { buildKeys } from "./keys.js";
import { buildResult, canLock, hasResult, lock, rows, showLocks, showResult } from "./result.js";
import { buildView, canvas, hasScene, legend, paint, partAt, point, show, shown } from "./view.js";

const POLL = 500; // milliseconds
const form = get("order").elements;
let seen = -1; // the version of the state
let packing = ""; // the packing that is shown
let kept = 0; // how many orders were sent
let isLoaded = false;
let shownFiles = "[]";
let faults = {}; // of the server

async function add(files) {
  get("refused").replaceChildren();
  for (const file of files) {
    say(`sending ${file.name}`);
    const query = new URLSearchParams({ name: file.name, unit: form.unit.value });
    try {
      await send(`/parts?${query}`, file);
    } catch (error) {
      get("refused").append(element("li", error.message));
    }
  }
  say("");
  await poll();
}

function order() {
  return {
    ...fieldValues(),
    box: boxValues(form.unit.value),
    unit: form.unit.value,
    objective: form.objective.value,
    instructions: form.instructions.checked,
    files: fileValues(),
  };
}

// Keep the order on the server, so that a reload of the page brings it back, and show what it says.
async function keep() {
  if (!isLoaded) return;
  const call = ++kept;
  const found = await attempt("/order", order());
  if (!found || call < kept) return; // an answer that another one overtook
  faults = found.faults;
  tellFaults();
  if (hasResult() || !found.boxes || !BoxScene.isPossible) return;
  show(found, 0, found.reach);
}

const tellFaults = () => showFaults({ ...faults, ...ownFaults() });

function restore(job) {
  for (const name of ["unit", "objective"]) form[name].value = job[name];
  form.instructions.checked = job.instructions;
  restoreFields(job);
  restoreFiles(job.files);
  restoreBoxes(job.box);
}

async function step(name) {
  if (get(name).disabled || isMoving()) return;
  await attempt(`/${name}`);
  await poll();
}

async function poll() {
  const query = new URLSearchParams({ seen, packing });
  const state = await (await fetch(`/state?${query}`)).json();
  if (state.version < seen) return; // an answer that another one overtook
  shown.isBusy = state.busy;
  get("stop").disabled = !state.busy;
  enable();
  if (state.version === seen) return;
  seen = state.version;
  get("undo").disabled = !state.undo;
  get("redo").disabled = !state.redo;
  const files = JSON.stringify(state.files);
  if (!isLoaded && state.order) {
    setBoxFiles(state.files);
    restore(state.order);
  }
  isLoaded = true;
  if (state.message || !/^sending/.test(get("message").textContent)) say(state.message);
  if (files !== shownFiles) {
    showFiles(state.files);
    setBoxFiles(state.files);
  }
  if (files !== shownFiles || !hasScene()) keep();
  shownFiles = files;
  if (Object.keys(state.faults).length) {
    faults = state.faults;
    tellFaults();
  }
  if (state.result) {
    packing = state.packing;
    shown.locked = new Set(state.locked);
    showResult(state.result, packing);
  } else if (!state.busy) refused(state.message);
  if (hasResult()) {
    showLocks(state.locked);
    legend();
    paint();
  }
}

async function watch() {
  try {
    await poll();
  } catch {
    say("the server does not answer: is the command still running?", true);
  }
  setTimeout(watch, POLL);
}

buildView(rows);
buildFields();
buildFiles(keep, poll);
buildResult(poll);
buildHand(poll);
buildKeys(step);
get("order").addEventListener("submit", async (event) => {
  event.preventDefault();
  await keep();
  tellFaults();
  if (document.querySelector("[aria-invalid]") || Object.keys(faults).length) {
    say("error: some fields need another value", true);
    goToFault();
    return;
  }
  await attempt("/pack", order());
  await poll();
});
get("order").addEventListener("change", keep);
get("stop").addEventListener("click", () => attempt("/stop"));
for (const name of ["undo", "redo"]) get(name).addEventListener("click", () => step(name));
get("write").addEventListener("click", async () => {
  await attempt("/write", { instructions: form.instructions.checked });
  await poll();
});
get("choose").addEventListener("change", async (event) => {
  await add([...event.target.files]);
  event.target.value = "";
});
addEventListener("dragover", (event) => {
  event.preventDefault();
  get("drop").classList.add("over");
});
addEventListener("dragleave", () => get("drop").classList.remove("over"));
addEventListener("drop", (event) => {
  event.preventDefault();
  get("drop").classList.remove("over");
  add([...event.dataTransfer.files]);
});
canvas.addEventListener("pointermove", (event) => {
  if (shown.view && !event.buttons) point(partAt(event));
});
canvas.addEventListener("pointerleave", (event) => { if (!event.buttons) point(null); });
let pressed = null;
canvas.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; });
canvas.addEventListener("click", (event) => {
  const isDrag = !pressed || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 4;
  pressed = null;
  if (isDrag || !canLock() || get("hand").getAttribute("aria-pressed") === "true") return;
  const part = partAt(event);
  if (part !== null && part < shown.found.boxes[shown.box].parts.length) lock(part, !shown.locked.has(part));
});
buildBoxes(keep).then(watch);
