// The tabs of the panel: answers, things, view.
import { byId } from "./dom";

const NAMES = ["answers", "things", "view"] as const;
export type Tab = (typeof NAMES)[number];

export function prepareTabs(): void {
  for (const name of NAMES) byId(`tab-${name}`).addEventListener("click", () => showTab(name));
}

export function showTab(shown: Tab): void {
  for (const name of NAMES) {
    byId(`tab-${name}`).setAttribute("aria-selected", String(name === shown));
    byId(name).hidden = name !== shown;
  }
}
