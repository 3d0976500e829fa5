// A row of buttons of which one is pressed.

import { element, fill } from "./elements.js";

export class Tabs {
  /** `onChoose(index)`. One name alone needs no button. */
  constructor(names, label, onChoose) {
    this.place = element("div", { class: "tabs", role: "group", "aria-label": label });
    this.buttons = names.map((name, i) =>
      element("button", { type: "button", class: "tab", click: () => onChoose(i) }, name),
    );
    if (names.length > 1) fill(this.place, ...this.buttons);
  }

  draw(chosen) {
    this.buttons.forEach((button, i) => {
      button.setAttribute("aria-pressed", String(i === chosen));
    });
  }
}
