// The panel beside the picture: texts, modes, levels, sliders.
import { button, byId, counted, element } from "./dom";
import type { Metadata } from "./scene_data";
import { HEAT, type Color, type Mode } from "./shader";
import type { Query, State } from "./state";

export const MODE_NAMES: readonly [Mode, string][] = [
  ["colour", "Colour"],
  ["heat", "Heat"],
  ["only", "Only the selection"],
  ["except", "All but the selection"],
  ["codes", "Codes"],
  ["confidence", "Confidence"],
];
const LEVEL_WORDS: Record<string, string> = { s: "fine", m: "medium", l: "coarse" };
const HEAT_STOPS = HEAT.map((color) => `rgb(${color.join(",")})`).join(",");
const SCORE_TITLE = "the share of everyday words that fit this scene less well than the text";
const TICKS = ["absent", "clean"] as const;
/** Modes that only the page can show, not the server. */
const PAGE_ONLY: readonly Mode[] = ["only", "except", "confidence"];

/** The elements of a text in the list. */
interface Row {
  all: HTMLElement;
  hide: HTMLElement;
  facts: HTMLElement;
  /** The facts that are shown, as JSON. */
  said: string;
  swatch: HTMLElement;
}

export class Panel {
  private readonly queries = byId("queries");
  private readonly rows = new Map<Query, Row>();
  private readonly threshold = byId<HTMLInputElement>("threshold");
  private readonly automatic = byId<HTMLInputElement>("threshold-auto");
  private readonly opacity = byId<HTMLInputElement>("opacity");

  constructor(
    private readonly state: State,
    private readonly metadata: Metadata,
    remote: boolean,
  ) {
    const modes = MODE_NAMES.map(([mode, name], number): [string, string, string] => [mode, name, `key ${number + 1}`]);
    choices("modes", "mode", modes, (mode) => state.set({ chosenMode: mode as Mode }));
    const levels = metadata.levels.map((name, level): [string, string, string] => [String(level), name in LEVEL_WORDS ? `${name} (${LEVEL_WORDS[name]})` : name, ""]);
    choices("levels", "level", [["auto", "automatic", ""], ...levels], (level) =>
      state.set({ level: level === "auto" ? null : Number(level) }));
    if (remote) {
      for (const mode of PAGE_ONLY) {
        const input = document.querySelector<HTMLInputElement>(`input[name=mode][value=${mode}]`)!;
        input.disabled = true;
        input.parentElement!.title = "needs the Gaussians in the browser; this page shows pictures of the server only";
      }
    }
    this.threshold.addEventListener("input", () => state.set({ threshold: Number(this.threshold.value) }));
    this.automatic.addEventListener("change", () =>
      state.set({ threshold: this.automatic.checked ? null : Number(this.threshold.value) }));
    this.opacity.addEventListener("input", () => state.set({ opacity: Number(this.opacity.value) }));
    for (const name of TICKS) byId(name).addEventListener("change", () => state.set({ [name]: byId<HTMLInputElement>(name).checked }));
  }

  update(): void {
    const { state } = this;
    check("mode", state.mode);
    check("level", state.level === null ? "auto" : String(state.level));
    const own = state.shown()[0]?.threshold;
    if (state.threshold === null && own !== undefined) this.threshold.value = String(own);
    if (state.threshold !== null) this.threshold.value = String(state.threshold);
    this.automatic.checked = state.threshold === null;
    const values = state.shown().map(({ text, things, threshold }) => `${text} ${things ? "by things" : threshold.toFixed(2)}`);
    byId("threshold-value").textContent = state.threshold === null ? values.join(", ") : state.threshold.toFixed(2);
    this.opacity.value = String(state.opacity);
    byId("opacity-value").textContent = state.opacity.toFixed(2);
    for (const name of TICKS) byId<HTMLInputElement>(name).checked = state[name];
    this.updateQueries();
    this.updateLegend();
  }

  /** The relevancy at the two ends of the colours; several texts have a colour each instead. */
  private updateLegend(): void {
    const shown = this.state.shown();
    const legend = byId("legend");
    legend.hidden = !(this.state.isHeat || this.state.mode === "confidence");
    byId("legend-bar").style.background = `linear-gradient(to right,${HEAT_STOPS})`;
    const [low, high] = this.state.isHeat ? shown[0].span : [0, 1];
    byId("legend-low").textContent = low.toFixed(2);
    byId("legend-high").textContent = high.toFixed(2);
    byId("legend-name").textContent = this.state.isHeat ? `relevancy to “${shown[0].text}”` : "confidence";
  }

  /** Rows stay the elements they are: a button keeps the focus, and only what changes is read aloud. */
  private updateQueries(): void {
    const { queries } = this.state;
    for (const [query, row] of this.rows) {
      if (queries.includes(query)) continue;
      row.all.remove();
      this.rows.delete(query);
    }
    for (const query of queries) {
      let row = this.rows.get(query);
      if (!row) {
        row = this.row(query);
        this.rows.set(query, row);
        this.queries.append(row.all);
      }
      const { text, present } = query.answer;
      const action = query.hidden ? "Show" : "Hide";
      say(row.hide, action);
      row.hide.setAttribute("aria-label", `${action} ${text}`);
      const facts = this.facts(query);
      const said = JSON.stringify(facts);
      if (row.said !== said) showFacts(row.facts, facts);
      row.said = said;
      const isHeat = this.state.isHeat && this.state.visible()[0] === query;
      // The border has the colour of its outline; what lights nothing up has none.
      row.swatch.style.border = isHeat ? `2px solid ${css(query.color)}` : "";
      const plain = present || this.state.absent ? css(query.color) : "transparent";
      row.swatch.style.background = isHeat ? `linear-gradient(to right,${HEAT_STOPS})` : plain;
      row.all.classList.toggle("hidden", query.hidden);
      row.all.classList.toggle("absent", !present);
    }
  }

  private row(query: Query): Row {
    const { text } = query.answer;
    const hide = button("", () => {
      query.hidden = !query.hidden;
      this.state.onChange();
    });
    const remove = button("✕", () => {
      const next = all.nextElementSibling ?? all.previousElementSibling;
      this.state.remove(query);
      // Not to the text box, which would open the keyboard of a telephone.
      (next?.querySelector<HTMLElement>("button:last-of-type") ?? byId("canvas")).focus();
    }, { "aria-label": `Remove ${text}` });
    const facts = element("span", { class: "facts" });
    const swatch = element("span", { class: "swatch" });
    const all = element("li", {}, swatch, element("span", { class: "text" }, text), hide, remove, facts);
    return { all, hide, facts, said: "", swatch };
  }

  /** Certainty, level and size of an answer. Score and size are those without a level or threshold of choice. */
  private facts(query: Query): [string, string][] {
    const { answer } = query;
    const { level, threshold } = this.state;
    const certainty = this.certainty(query);
    if (!answer.present) return [certainty];
    const facts = [levelFact(this.metadata.levels[this.state.levelOf(query)])];
    if (level !== null || threshold !== null) return facts;
    const things = answer.chosen_things?.length ? [plain(counted(answer.chosen_things.length, "thing"))] : [];
    const other = answer.runner_up ? [plain(`or ${this.nameOf(answer.runner_up.thing)}`)] : [];
    return [...things, ...(answer.score === null ? [] : [certainty]), ...other, ...facts, plain(counted(answer.gaussians, "Gaussian"))];
  }

  private certainty({ answer }: Query): [string, string] {
    const { score, certainty } = answer;
    if (answer.remark) return [answer.remark, ""];
    if (score === null) return ["not here", ""];
    return [certainty ?? "", `Score ${score.toFixed(2)}: ${SCORE_TITLE}; present from ${this.metadata.present_from}, if enough Gaussians answer.`];
  }

  private nameOf(thing: number): string {
    const plain = `thing ${thing}`;
    const name = this.state.things?.nameOf(thing) ?? plain;
    return name === plain ? plain : `${name} (${plain})`;
  }
}

/** A fact without a tooltip. */
function plain(text: string): [string, string] {
  return [text, ""];
}

/** A level in words, with its name as the tooltip. */
export function levelFact(level: string): [string, string] {
  return [level in LEVEL_WORDS ? `${LEVEL_WORDS[level]} level` : `level ${level}`, `Level ${level}, of fine to coarse: parts, objects, groups`];
}

/** Radio buttons in a row. */
function choices(id: string, name: string, options: [string, string, string][], onPick: (value: string) => void): void {
  const labels = options.map(([value, text, title]) => {
    const input = element("input", { type: "radio", name, value });
    input.addEventListener("change", () => onPick(value));
    return element("label", title ? { title } : {}, input, text);
  });
  byId(id).replaceChildren(...labels);
}

/** Facts with their tooltips, separated by commas. */
export function showFacts(out: HTMLElement, facts: [string, string][]): void {
  const parts = facts.map(([text, title]) => (title ? element("span", { title, class: "explained" }, text) : text));
  out.replaceChildren(...parts.flatMap((part, number) => (number ? [", ", part] : [part])));
}

function css(color: Color): string {
  return `rgb(${color.map((part) => Math.round(part * 255)).join(",")})`;
}

function say(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

function check(name: string, value: string): void {
  const input = document.querySelector<HTMLInputElement>(`input[name=${name}][value="${value}"]`);
  if (input) input.checked = true;
}
