// Completion of the text box: of its last text, where a comma separates several.
import { byId, element } from "./dom";

export function completeFrom(names: string[]): void {
  const box = byId<HTMLInputElement>("text");
  const list = byId("names");
  let before: string | null = null;
  const update = () => {
    // The browser compares an option with all that was typed, so options begin with the texts before the last.
    const start = /^.*,\s*/.exec(box.value)?.[0] ?? "";
    if (start === before) return;
    before = start;
    list.replaceChildren(...names.map((name) => element("option", { value: start + name })));
  };
  box.addEventListener("input", update);
  update();
}
