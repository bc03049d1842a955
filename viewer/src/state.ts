// What is on the screen: texts, mode, level, threshold, opacity.
import type { Answer, PictureRequest, Selection } from "./answers";
import type { CameraRecord } from "./scene_data";
import { MOST_QUERIES, type Color, type Mode } from "./shader";
import type { Look, ShownQuery } from "./splat";
import type { Things } from "./things";

/** Of texts, in their order: easy to tell apart on grey, for the colour-blind too. */
const COLORS: readonly Color[] = [
  [0.96, 0.62, 0.07], [0.25, 0.72, 0.96], [0.35, 0.86, 0.45], [0.93, 0.4, 0.72], [0.98, 0.91, 0.35], [0.62, 0.52, 0.98],
  [0.95, 0.36, 0.27], [0.55, 0.95, 0.9],
];

export interface Query {
  answer: Answer;
  color: Color;
  hidden: boolean;
}

export class State {
  queries: Query[] = [];
  /** Null: heat as soon as there is a text, colours if it is a phrase, for which relevancy says little. */
  chosenMode: Mode | null = null;
  /** Null: of each text its own. */
  level: number | null = null;
  threshold: number | null = null;
  opacity = 0.6;
  /** Whether texts count that are not in the scene. */
  absent = false;
  /** Whether haze and needles are left out of the selection alone. */
  clean = false;
  /** Ends of a length that is measured, none to two; null where no click measures. */
  measured: number[][] | null = null;
  onChange: () => void = () => {};
  /** Null where the field has none, and in pages that get no Gaussians. */
  things: Things | null = null;
  readonly levels: number;

  /** `metresPerUnit` is null as long as the length of the scene's unit is not known. */
  constructor(levels: number, public metresPerUnit: number | null) {
    this.levels = levels;
  }

  get mode(): Mode {
    return this.chosenMode ?? (this.queries.every(({ answer }) => answer.remark !== null) ? "colour" : "heat");
  }

  /** Add answers; a text that is there already is replaced. */
  add(answers: Answer[]): void {
    for (const answer of answers) {
      const same = this.queries.find((query) => query.answer.text === answer.text);
      if (same) {
        same.answer = answer;
        same.hidden = false;
        continue;
      }
      if (this.queries.length >= MOST_QUERIES) this.queries.shift();
      const used = this.queries.map((query) => query.color);
      const color = COLORS.find((each) => !used.includes(each)) ?? COLORS[0];
      this.queries.push({ answer, color, hidden: false });
    }
    this.onChange();
  }

  remove(query: Query): void {
    this.queries = this.queries.filter((each) => each !== query);
    this.onChange();
  }

  set(change: Partial<Pick<State, "chosenMode" | "level" | "threshold" | "opacity" | "absent" | "clean" | "measured" | "metresPerUnit">>): void {
    Object.assign(this, change);
    this.onChange();
  }

  /** Lengths of the scene in words. */
  lengths(...values: number[]): string {
    const text = values.map((value) => (value * (this.metresPerUnit ?? 1)).toLocaleString("en", { maximumSignificantDigits: 3 })).join(" × ");
    return `${text} ${this.metresPerUnit === null ? "scene units" : "m"}`;
  }

  /** The level of the things that a click selects. */
  get clickLevel(): number {
    return this.level ?? Math.floor(this.levels / 2);
  }

  levelOf(query: Query): number {
    return this.level ?? query.answer.level;
  }

  /** Things that answer; null where the votes of the Gaussians do, as they do with a threshold of one's own. */
  thingsOf({ answer }: Query): number[] | null {
    if (this.threshold !== null) return null;
    return this.level === null ? answer.chosen_things : answer.things[this.level];
  }

  /** Texts that colour something. Presence is judged without a level or threshold of choice. */
  visible(): Query[] {
    return this.queries.filter((query) => !query.hidden && (query.answer.present || this.absent));
  }

  shown(): ShownQuery[] {
    return this.visible().map((query) => {
      const { answer, color } = query;
      const level = this.levelOf(query);
      const threshold = this.threshold ?? answer.thresholds[level];
      return { text: answer.text, scores: answer.scores, level, threshold, things: this.thingsOf(query), without: answer.without, span: answer.spans[level], color };
    });
  }

  /** Whether the colours are those of one text's relevancy. */
  get isHeat(): boolean {
    return this.mode === "heat" && this.visible().length === 1;
  }

  look(): Look {
    const first = this.visible()[0];
    const level = this.level ?? first?.answer.level ?? this.clickLevel;
    const { selected = [], hidden = [] } = this.things ?? {};
    return { mode: this.mode, level, opacity: this.opacity, clean: this.clean, selected, hidden };
  }

  /** What is saved: the things that are selected, or else what the texts select. */
  selection(): Selection {
    const things = (this.things?.selected ?? []).map((number) => ({ number, name: this.things!.nameOf(number) }));
    const texts = this.visible().map((query) => query.answer.text);
    const { level, threshold } = this;
    return { things, texts, level, threshold, rest: this.mode === "except", always: this.absent };
  }

  /** What the server is to render in place of the page's own picture. */
  picture(camera: CameraRecord, quality: number): PictureRequest {
    const visible = this.visible();
    const modes = { colour: "mask", heat: "heat", only: "mask", except: "mask", codes: "codes" } as const;
    let mode: PictureRequest["mode"] = this.mode in modes ? modes[this.mode as keyof typeof modes] : "color";
    if (!visible.length && mode !== "codes") mode = "color";
    const level = mode === "codes" ? this.look().level : this.level;
    const answering = mode === "heat" || mode === "mask" ? visible : [];
    const texts = answering.map(({ answer }) => answer.text);
    const colors = answering.map(({ color }): [number, number, number] => [255 * color[0], 255 * color[1], 255 * color[2]]);
    return { camera, mode, texts, colors, opacity: this.opacity, level, threshold: this.threshold, always: this.absent, quality };
  }
}
