// A model as a command and as a file: what is taken away from the page.

import { action, element } from "./elements.js";
import { measured } from "./words.js";

/** A word as a POSIX shell reads it back. */
export function quoted(word) {
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", `'\\''`)}'`;
}

/** The command that fits this model. */
export function command(name, labels) {
  const effects = labels.map((label) => ` --with ${quoted(label)}`);
  return `residyn fit ${quoted(name)}${effects.join("")}`;
}

/** A file that holds the experiment and, as comments, the model. */
export function toml(text, line, numbers) {
  const safe = (x) => String(x).replace(/\p{Cc}/gu, " ");
  const model = numbers.map((n) => `#   ${safe(n.name)} = ${measured(n.value, n.std, n.unit)}`);
  const head = ["", "# The model that was looked at:", `#   ${safe(line)}`, ...model, ""];
  return `${(text ?? "").replace(/\n*$/, "\n")}${head.join("\n")}`;
}

/** Buttons for both, and a line that says what was done. */
export class Saving {
  /** `line()` the command; `file()` the text. */
  constructor(line, file) {
    Object.assign(this, { line, file });
    this.said = element("span", { class: "said", role: "status" });
    this.parts = [
      action("Copy as command", () => this.copy()),
      action("Save as TOML", () => this.save()),
    ];
  }

  async copy() {
    const line = this.line();
    try {
      await navigator.clipboard.writeText(line);
      this.said.textContent = `Copied: ${line}`;
    } catch {
      this.said.textContent = line; // a page from a file may not be allowed to copy
    }
  }

  save() {
    const address = URL.createObjectURL(new Blob([this.file()], { type: "application/toml" }));
    element("a", { href: address, download: "explored.toml" }).click();
    URL.revokeObjectURL(address);
    this.said.textContent = "Saved as explored.toml.";
  }
}
