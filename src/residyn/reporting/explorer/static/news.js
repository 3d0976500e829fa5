// What the server tells meanwhile: the search, files that changed or are new, what was hidden.

import { action, element, fill } from "./elements.js";

const PERIOD = 1000; // ms
const MOST_FILES = 3; // offered at a time

export class News {
  /**
   * `page`: `learn(news)` takes what the search has added, `names(label)` an effect in words,
   * `chosen()` what is on, `chips.first` what is shown first; `open(study, hidden)` shows another
   * study; `hidden`: whether an effect is hidden in this one.
   */
  constructor(server, page, open, hidden) {
    Object.assign(this, { server, page, open, hidden });
    this.place = element("div", { class: "banner", role: "status" });
    this.ended = false; // the search
    this.version = 0;
  }

  /** Ask now and then, until `stop`. */
  async follow() {
    for (let rounds = 0; !this.stopped; rounds++) {
      if (rounds) await new Promise((resolve) => setTimeout(resolve, PERIOD));
      if (this.stopped || (rounds && document.hidden)) continue;
      try {
        await this.once();
      } catch {
        this.told = null;
        this.place.textContent = "The server has stopped; what is here can still be looked at.";
      }
    }
  }

  stop() {
    this.stopped = true;
  }

  async once() {
    const { page } = this;
    const seen = encodeURIComponent(JSON.stringify([page.chosen(), page.chips.first]));
    const state = await this.server.get(`state?seen=${seen}`);
    if (this.stopped) return;
    this.ended = !state.words;
    if (state.version !== this.version) {
      const news = await this.server.get(`searched?since=${this.page.fetched}`);
      if (this.stopped) return;
      this.version = state.version;
      this.page.learn(news);
    }
    this.tell(state);
  }

  tell(state) {
    const key = JSON.stringify([state.words, state.changed, state.new, state.error]);
    if (key === this.told) return;
    this.told = key;
    const said = (...parts) => element("span", {}, ...parts);
    const parts = [];
    if (state.words) {
      const words = `Searching for what is missing: ${state.words} ...`;
      parts.push(element("span", { class: "searching" }, words));
    }
    if (state.error) parts.push(said(state.error));
    if (state.changed.length) {
      const again = action("Read again", () => this.reload([]));
      parts.push(said(`${state.changed.join(", ")} changed on disk. `, again));
    }
    for (const name of state.new.slice(0, MOST_FILES)) {
      const add = action("Add this recording", () => this.reload([name]));
      parts.push(said(`New in the folder: ${name}. `, add));
    }
    if (this.hidden) parts.push(this.riddle());
    fill(this.place, ...parts);
  }

  async reload(add) {
    const found = await this.server.post("reload", { add });
    if (found.error) return this.page.complain(found.error);
    await this.open(found.study, false);
  }

  riddle() {
    const answer = element("span", {});
    const tell = async () => {
      const { hidden } = await this.server.post("reveal", {});
      const right = this.page.chosen().includes(hidden);
      answer.textContent = ` It was ${this.page.name(hidden)}.${right ? " Correct." : ""}`;
    };
    return element(
      "span",
      {},
      "An effect is hidden in this simulated arm: which one? ",
      action("Tell me", tell),
      " ",
      action("Back to the recordings", () => this.open(this.server.home ?? 0, false)),
      answer,
    );
  }
}
