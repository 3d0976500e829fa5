// Elements of the page. Words are text, whatever is in them: nothing here reads markup.

/** An element with attributes (functions listen, true is set, false and null are left out). */
export function element(tag, attributes = {}, ...children) {
  const found = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") found.addEventListener(name, value);
    else if (value === true) found.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined)
      found.setAttribute(name, value);
  }
  found.append(...children.filter((c) => c !== null && c !== ""));
  return found;
}

/** Replace all that an element holds. */
export function fill(place, ...children) {
  place.replaceChildren(...children.filter((c) => c !== null && c !== ""));
}

/** A button with words. */
export function action(words, click, more = {}) {
  return element("button", { type: "button", class: "action", click, ...more }, words);
}
