// What the page shows, and who is told when it changes.

export class State {
  constructor(initial) {
    this.values = initial;
    this.listeners = [];
  }

  get(name) {
    return this.values[name];
  }

  /** Call `listener(values, changed)` after changes of any of these names. */
  on(names, listener) {
    this.listeners.push([names, listener]);
  }

  /** Change some values, and tell those who listen to any that is not as it was. */
  set(values) {
    const changed = Object.keys(values).filter((name) => this.values[name] !== values[name]);
    Object.assign(this.values, values);
    for (const [names, listener] of this.listeners) {
      if (names.some((name) => changed.includes(name))) listener(this.values, changed);
    }
  }
}
