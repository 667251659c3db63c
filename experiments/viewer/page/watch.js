// A page that follows a run: its server tells what changes, by name.

class Watch {
  constructor(player, panels) {
    this.player = player;
    this.panels = panels;
    this.known = new Map();
    this.chosen = null;
    document.getElementById("learning").hidden = false;
    document.querySelector("main").classList.add("follows");
    const source = new EventSource("events");
    for (const name of ["status", "curves", "panel", "rooms"]) {
      source.addEventListener(name, (event) => this[name](JSON.parse(event.data)));
    }
    source.addEventListener("error", () => this.say("The page has lost its server; it tries again."));
  }

  say(text) { document.getElementById("state").textContent = text; }

  status({ said, figures, clients }) {
    this.say(said);
    document.getElementById("figures").replaceChildren(...figures.map(([name, value]) =>
      element("div", {}, element("dt", {}, name), element("dd", {}, value))));
    const rows = clients.map((row) => element("tr", {}, ...row.map((cell) => element("td", {}, cell))));
    const head = ["Client", "State", "Traffic"].map((name) => element("th", { scope: "col" }, name));
    document.getElementById("clients").replaceChildren(...(rows.length
      ? [element("table", {}, element("caption", {}, "Flower clients"), element("tr", {}, ...head), ...rows)] : []));
  }

  curves({ unit, train, explored, greedy }) {
    const blue = "#0072b2", orange = "#d55e00", grey = "#8a94a0";
    const frozen = (measure) => [
      { name: "frozen, exploring", colour: blue, x: explored.at, y: explored[measure], dots: true },
      { name: "frozen, greedy", colour: orange, x: greedy.at, y: greedy[measure], dots: true, dashed: true },
    ];
    const training = (measure) => ({ name: "training", colour: grey, x: train.at, y: train[measure] });
    document.getElementById("charts").replaceChildren(
      chart("Robots that arrive", [training("success"), ...frozen("success")], unit, [0, 1]),
      chart("Energy efficiency, bit/s/Hz/J", [training("ee"), ...frozen("ee")], unit),
      chart("Total reward of an episode", [training("reward")], unit),
    );
  }

  panel(panel) {
    this.panels(panel ? [panel] : []);
  }

  // A wall of small rooms; each is fetched when it comes into sight and when it has a new episode.
  rooms(rooms) {
    document.getElementById("wall").hidden = false;
    for (const { name, said, version } of rooms) {
      const room = this.known.get(name) || this.hang(name);
      room.text.textContent = `${name}: ${said}`;
      room.wanted = version;
      this.fetchRoom(name);
    }
    if (this.chosen === null && rooms.length) this.choose(rooms[0].name);
  }

  hang(name) {
    const text = element("span");
    const button = element("button", { type: "button", class: "room", "aria-pressed": "false" }, text);
    const room = { text, button, version: null, seen: false };
    this.known.set(name, room);
    button.addEventListener("click", () => this.choose(name));
    new IntersectionObserver((entries) => {
      room.seen = entries.some((entry) => entry.isIntersecting);
      this.fetchRoom(name);
    }).observe(button);
    document.getElementById("rooms").append(button);
    return room;
  }

  async fetchRoom(name) {
    const room = this.known.get(name), wanted = room.wanted;
    if (room.version === wanted || !(room.seen || this.chosen === name)) return;
    room.version = wanted;
    const answer = await fetch(`room/${encodeURIComponent(name)}`);
    if (!answer.ok) return;
    room.panel = await answer.json();
    room.floor = new Floor(room.panel.scene, false);
    room.button.replaceChildren(room.floor.box, room.text);
    if (this.chosen === name) this.show();
    else this.player.floors = this.floors();
  }

  async choose(name) {
    this.known.get(this.chosen)?.button.setAttribute("aria-pressed", "false");
    this.chosen = name;
    this.known.get(name).button.setAttribute("aria-pressed", "true");
    await this.fetchRoom(name);
    this.show();
  }

  show() {
    const { panel } = this.known.get(this.chosen);
    if (panel) this.panels([panel], this.floors());
  }

  floors() {
    return [...this.known.values()].filter((room) => room.floor)
      .map((room) => ({ floor: room.floor, cells: room.panel.episode.cells }));
  }
}
