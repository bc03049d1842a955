// What is said of a point that was clicked.
import type { Place } from "./answers";
import { button, byId, copy, element } from "./dom";
import { levelFact, showFacts } from "./panel";
import type { State } from "./state";

/** Show a place; call what is returned once lengths have another unit. */
export function showPlace(place: Place, state: State): () => void {
  const panel = byId("place");
  panel.hidden = false;
  const close = button("✕", hidePlace, { "aria-label": "Close" });
  const heading = element("div", { class: "row" }, element("h2", { style: "flex:1" }, "Here is"), close);
  if (place.position === null) {
    panel.replaceChildren(heading, "nothing: no Gaussian contributes to this point.");
    panel.scrollIntoView({ block: "nearest" });
    return () => {};
  }
  const list = element("dl");
  for (const { level, confidence, words } of place.levels) {
    const title = element("dt");
    const agreement = confidence >= 0.9 ? "views agree" : confidence >= 0.6 ? "most views agree" : "views disagree";
    const facts: [string, string][] = [levelFact(level), [agreement, `Confidence ${confidence.toFixed(2)}`]];
    showFacts(title, words.length ? facts : facts.slice(0, 1));
    const said = element("dd", { "data-level": level }, words.length ? "" : "no code here");
    showFacts(said, words.map(({ text, relevancy }) => [text, relevancy === null ? "" : `Relevancy ${relevancy.toFixed(2)}`]));
    list.append(title, said);
  }
  const position = place.position.map((part) => part.toPrecision(5)).join(", ");
  const where = element("dd");
  const sayWhere = () => {
    const said = `(${position}), ${state.lengths(place.distance!)} away`;
    if (where.textContent !== said) where.textContent = said; // which is read aloud
  };
  sayWhere();
  list.append(element("dt", {}, "position, distance"), where);
  panel.replaceChildren(heading, list, button("Copy position", () => void copy(`[${position}]`)));
  panel.scrollIntoView({ block: "nearest" });
  return sayWhere;
}

export function hidePlace(): void {
  byId("place").hidden = true;
  byId("marker").hidden = true;
}
