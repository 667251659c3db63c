// Puts the page together.

const data = JSON.parse(document.getElementById("data").textContent);
const player = new Player();

function showPanels(panels, floors = []) {
  const made = panels.map((panel) => new Panel(panel));
  document.getElementById("panels").replaceChildren(...made.map((panel) => panel.box));
  player.take(made, floors);
}

document.getElementById("title").textContent = document.title;
showPanels(data.panels);
if (data.follows) new Watch(player, showPanels);
