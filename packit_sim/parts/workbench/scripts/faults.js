// Messages next to the fields that they are about.
import { get } from "./page.js";

// Show what is wrong, by the names of fields; fields without an own place share the one above "Pack".
export function showFaults(faults) {
  const others = [];
  document.querySelectorAll(".fault[id^=fault-]").forEach((place) => { place.textContent = ""; });
  document.querySelectorAll("#order [aria-invalid], #files [aria-invalid]").forEach((field) => field.removeAttribute("aria-invalid"));
  for (const [name, text] of Object.entries(faults)) {
    const place = get(`fault-${name.replace(" ", "-")}`);
    if (place) place.textContent = text;
    else others.push(text);
    document.querySelectorAll(`[aria-describedby~="fault-${name.replace(" ", "-")}"]`).forEach((field) => field.setAttribute("aria-invalid", "true"));
    if (place && place.closest("details")) place.closest("details").open = true;
    if (place && place.closest("tr[hidden]")) place.closest("tr[hidden]").hidden = false;
  }
  get("fault-other").textContent = others.join(" ");
}

// Return the faults of numbers as the page can tell them itself.
export function ownFaults() {
  const found = {};
  document.querySelectorAll("input[data-fault]").forEach((field) => {
    if (!field.disabled && field.offsetParent !== null && !field.checkValidity()) found[field.dataset.name] = field.dataset.fault;
  });
  return found;
}

// Go to the first field that needs another value.
export function goToFault() {
  const field = document.querySelector("[aria-invalid]");
  const place = [...document.querySelectorAll(".fault")].find((each) => each.textContent);
  if (field) field.focus();
  if (field || place) (field || place).scrollIntoView({ block: "center" });
}
