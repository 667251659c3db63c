// The clock of all panels: plays, pauses, scrubs.

const SLOTS_PER_S = 6, REST_S = 1.5;

class Player {
  constructor() {
    this.panels = [];
    this.time = 0;
    this.rested = 0;
    this.calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.playing = !this.calm;
    this.button = document.getElementById("play");
    this.scrub = document.getElementById("scrub");
    this.slot = document.getElementById("slot");
    this.spoken = document.getElementById("spoken");
    this.button.addEventListener("click", () => this.toggle());
    this.scrub.addEventListener("input", () => this.seek(Number(this.scrub.value)));
    document.addEventListener("keydown", (event) => this.press(event));
    requestAnimationFrame((now) => this.frame(now, now));
  }

  get end() { return Math.max(1, ...this.panels.map((panel) => panel.slots)); }

  // Shows other episodes; a player that plays begins them anew.
  take(panels, floors = []) {
    this.panels = panels;
    this.floors = floors;
    this.scrub.max = this.end;
    this.time = Math.min(this.playing ? 0 : this.time, this.end);
    this.draw();
  }

  toggle() {
    this.playing = !this.playing;
    if (this.playing && this.time >= this.end) this.time = 0;
    this.rested = 0;
    this.draw();
    if (!this.playing) this.say();
  }

  seek(time) {
    this.playing = false;
    this.time = Math.min(Math.max(time, 0), this.end);
    this.draw();
    this.say();
  }

  press(event) {
    const within = event.target.closest("button, select, input, a");
    if (event.ctrlKey || event.metaKey || event.altKey || within) return;
    const slot = Math.floor(this.time + 1e-9);
    const to = { ArrowLeft: slot === this.time ? slot - 1 : slot, ArrowRight: slot + 1, Home: 0, End: this.end };
    if (event.key === " ") this.toggle();
    else if (event.key in to) this.seek(to[event.key]);
    else return;
    event.preventDefault();
  }

  frame(now, before) {
    if (this.playing && this.panels.length) this.advance(Math.min((now - before) / 1000, .1));
    requestAnimationFrame((next) => this.frame(next, now));
  }

  advance(seconds) {
    const speed = Number(document.getElementById("speed").value);
    if (this.time < this.end) {
      this.time = Math.min(this.time + seconds * speed * SLOTS_PER_S, this.end);
    } else if ((this.rested += seconds) > REST_S) {
      this.time = this.rested = 0;
    }
    this.draw();
  }

  draw() {
    for (const panel of this.panels) panel.show(this.time);
    for (const { floor, cells } of this.floors || []) floor.show(cells, Math.min(this.time, cells.length - 1));
    this.scrub.value = this.time;
    const slot = Math.min(Math.floor(this.time) + 1, this.end);
    this.slot.textContent = `slot ${slot} of ${this.end}`;
    this.scrub.setAttribute("aria-valuetext", this.slot.textContent);
    const label = this.playing ? "Pause" : "Play";
    if (this.button.textContent !== label) this.button.textContent = label;
  }

  say() {
    if (this.panels.length) this.spoken.textContent = this.panels[0].words(this.time);
  }
}
