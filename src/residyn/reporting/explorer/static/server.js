// The live server: what the page asks it for. Nothing here runs in a report.

import { opened } from "./arrays.js";

/** A random name of this window, so that two do not disturb each other. */
const WINDOW = crypto.randomUUID?.() ?? String(Math.random());

export class Server {
  constructor() {
    this.study = 0;
    this.number = 0;
  }

  async get(what) {
    const answer = await fetch(`api/${this.study}/${what}`, { cache: "no-store" });
    return opened(await answer.json());
  }

  async post(what, body) {
    const answer = await fetch(`api/${this.study}/${what}`, {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(body),
    });
    return opened(await answer.json());
  }

  /** A fit: "smoothed", that with what is held out "predicted", or "refitted"; null if a newer one
   * was asked for meanwhile. */
  async fit(added, held, how) {
    const number = ++this.number;
    const study = this.study;
    const found = await this.post("fit", {
      window: WINDOW,
      number,
      added,
      how,
      held: Object.fromEntries(held),
    });
    if (number !== this.number || study !== this.study || found.superseded) return null;
    return found;
  }

  /** Wait until the payload is there; `say(words)` meanwhile. */
  async payload(say) {
    for (;;) {
      const state = await this.get("state");
      if (state.error) throw new Error(state.error);
      if (state.ready) return this.get("payload");
      say(state.words);
      await new Promise((resolve) => setTimeout(resolve, 300));
    }
  }
}
