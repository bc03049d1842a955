// The things in the panel: a card of what is selected, and the list that typing filters.
import { button, byId, counted, element } from "./dom";
import { levelFact, showFacts } from "./panel";
import type { Thing } from "./scene_data";
import type { State } from "./state";
import type { Things } from "./things";

/** Rows of the list at most; typing finds the others. */
const MOST_ROWS = 200;

/** `place` says what is at the point that was clicked. */
export class ThingPanel {
  private readonly filter = byId<HTMLInputElement>("thing-filter");
  private carded = "";
  private listed = "";

  constructor(
    private readonly things: Things,
    private readonly state: State,
    private readonly levels: string[],
    private readonly actions: Record<"save" | "place", () => void>,
  ) {
    byId("tab-things").hidden = false;
    this.filter.addEventListener("input", () => this.update());
    byId("thing-show-all").addEventListener("click", () => things.showAll());
    this.update();
  }

  update(): void {
    const { things } = this;
    // A card that is as it was keeps its elements, so that its name can be typed.
    const card = JSON.stringify([things.selected, this.state.metresPerUnit]);
    if (card !== this.carded) this.showCard();
    this.carded = card;
    const list = JSON.stringify([this.filter.value, things.selected, [...things.hidden], things.revision]);
    if (list !== this.listed) this.showList();
    this.listed = list;
  }

  private showCard(): void {
    const { things } = this;
    const card = byId("selection");
    card.hidden = !things.selected.length;
    const rows = things.selected.map((number) => this.cardRow(things.of(number)));
    const buttons = [
      button("Hide", () => things.hide()),
      button("Save", this.actions.save),
      button("What is here?", this.actions.place),
      button("Clear", () => things.select([])),
    ];
    const distance = things.distance();
    const measured = distance === null ? [] : [element("p", { class: "measure" }, `Distance ${this.state.lengths(distance)} between their centres`)];
    card.replaceChildren(...rows, ...measured, element("div", { class: "row wrap" }, ...buttons));
  }

  private cardRow(thing: Thing): HTMLElement {
    const { things } = this;
    const label = `Name of thing ${thing.number}`;
    const name = element("input", { type: "text", "aria-label": label, maxlength: "80", value: things.nameOf(thing.number) });
    name.addEventListener("change", () => {
      things.rename(thing.number, name.value);
      name.value = things.nameOf(thing.number);
    });
    name.addEventListener("keydown", (event) => {
      if (event.key === "Enter") name.blur();
    });
    const size = this.state.lengths(...thing.box.extent);
    const facts = element("span", { class: "facts" });
    const detected: [string, string][] = thing.named_by === "detector" ? [["named by a detector", ""]] : [];
    const regions = `Merged from ${counted(thing.views, "region")}`;
    showFacts(facts, [...detected, levelFact(this.levels[thing.level]), [counted(thing.gaussians, "Gaussian"), regions], [`size ${size}`, ""]]);
    return element("div", { class: "thing" }, name, facts);
  }

  private showList(): void {
    const { things } = this;
    const found = things.matching(this.filter.value).sort((a, b) => b.level - a.level || b.gaussians - a.gaussians);
    byId("thing-list").replaceChildren(...found.slice(0, MOST_ROWS).map((thing) => element("li", {}, this.row(thing))));
    const more = found.length - MOST_ROWS;
    byId("thing-count").textContent = more > 0 ? `${more.toLocaleString("en")} more: type to find them.` : counted(found.length, "thing");
    const hidden = byId("thing-show-all");
    hidden.hidden = !things.hidden.size;
    hidden.textContent = `Show ${things.hidden.size} hidden`;
  }

  private row(thing: Thing): HTMLElement {
    const { things } = this;
    const facts = `${levelFact(this.levels[thing.level])[0]}, ${counted(thing.gaussians, "Gaussian")}`;
    const row = element("button", { type: "button", "data-thing": String(thing.number) },
      element("span", { class: "text" }, things.nameOf(thing.number)), element("span", { class: "facts" }, facts));
    row.setAttribute("aria-pressed", String(things.selected.includes(thing.number)));
    row.classList.toggle("hidden", things.hidden.has(thing.number));
    row.addEventListener("click", (event) => {
      if (event.shiftKey) things.toggle(thing.number);
      else things.select([thing.number]);
    });
    row.addEventListener("pointerenter", () => things.hover(thing.number));
    row.addEventListener("pointerleave", () => things.hover(null));
    return row;
  }
}
