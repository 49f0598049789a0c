// What all scripts of the page use: elements, requests to the server, and messages.

export const UNITS = ["mm", "cm", "in", "m"];

export const get = (id) => document.getElementById(id);

export function element(tag, text = null, more = {}, ...children) {
  const made = Object.assign(document.createElement(tag), text === null ? {} : { textContent: text }, more);
  made.append(...children);
  return made;
}

export function choice(options, value, label) {
  const made = element("select", null, {}, ...Object.entries(options).map(([name, text]) => element("option", text, { value: name })));
  made.value = value;
  made.setAttribute("aria-label", label);
  return made;
}

export function swatch(color) {
  const made = element("span", null, { className: "swatch" });
  made.style.background = color;
  return made;
}

export async function send(path, body) {
  const isJson = body !== undefined && !(body instanceof Blob);
  const answer = await fetch(path, { method: "POST", body: isJson ? JSON.stringify(body) : body });
  const found = await answer.json();
  if (!answer.ok) throw new Error(found.error);
  return found;
}

export function say(text, isError = false) {
  const message = get("message");
  message.textContent = text;
  message.classList.toggle("error", isError || /^(unexpected )?error:/.test(text));
  message.classList.toggle("done", /^done/.test(text));
  const [, done, total] = /, (\d+) of (\d+)$/.exec(text) || [];
  const bar = get("progress");
  bar.hidden = total === undefined;
  if (total !== undefined) Object.assign(bar, { max: Number(total), value: Number(done) });
}

// Send a request, and show its error as the message of the page.
export async function attempt(path, body) {
  try {
    return await send(path, body);
  } catch (error) {
    say(error.message, true);
    return null;
  }
}
