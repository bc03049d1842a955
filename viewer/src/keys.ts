// Keys of the page, and the list of them in the help.
import { byId, element } from "./dom";
import type { Eye } from "./camera";
import { MODE_NAMES } from "./panel";
import type { State } from "./state";

const HELP: [string, string][] = [
  ["drag", "orbit the centre"],
  ["right drag, two fingers", "move sideways"],
  ["wheel, pinch", "closer, farther"],
  ["click, tap", "select the thing there; again: its group (without things: what is there?)"],
  ["Shift click", "select more"],
  ["Alt click", "select its part under the pointer"],
  ["/", "to the text box"],
  ["1 to 6", "modes"],
  ["W A S D, Q E", "move; down and up"],
  ["arrows", "turn; closer, farther"],
  ["X", "exact picture, on and off"],
  ["M", "measure a length between two points"],
  ["Esc", "close what is open"],
];

export function listenToKeys(state: State, eye: Eye, actions: Record<"toggleExact" | "measure" | "escape", () => void>): void {
  byId("help-keys").replaceChildren(
    ...HELP.flatMap(([key, meaning]) => [element("dt", {}, key), element("dd", {}, meaning)]),
  );
  const help = byId<HTMLDialogElement>("help");
  byId("help-open").addEventListener("click", () => help.showModal());
  const moves: Record<string, () => void> = {
    w: () => eye.step(0, 0, 1),
    s: () => eye.step(0, 0, -1),
    a: () => eye.step(-1, 0, 0),
    d: () => eye.step(1, 0, 0),
    q: () => eye.step(0, -1, 0),
    e: () => eye.step(0, 1, 0),
    ArrowUp: () => eye.step(0, 0, 1),
    ArrowDown: () => eye.step(0, 0, -1),
    ArrowLeft: () => eye.turn(-0.08),
    ArrowRight: () => eye.turn(0.08),
    "/": () => byId("text").focus(),
    "?": () => help.showModal(),
    x: actions.toggleExact,
    m: actions.measure,
    Escape: actions.escape,
  };
  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || help.open) return;
    const focused = document.activeElement;
    const input = focused instanceof HTMLInputElement ? focused : null;
    const typing = input?.type === "text";
    if (typing && event.key !== "Escape") return;
    if (input && event.key.startsWith("Arrow")) return; // they move sliders and choices
    const mode = MODE_NAMES[Number(event.key) - 1];
    if (mode) {
      const choice = document.querySelector<HTMLInputElement>(`input[name=mode][value=${mode[0]}]`);
      if (!choice?.disabled) state.set({ chosenMode: mode[0] });
      return;
    }
    const move = moves[event.key] ?? moves[event.key.toLowerCase()];
    if (!move) return;
    event.preventDefault();
    if (typing) input.blur();
    move();
  });
}
