// Outlines of what is selected, over the picture while the camera rests: things in the colour of clicks, texts in their own.
import type { Eye } from "./camera";
import { byId } from "./dom";
import { Silhouette } from "./outline";
import { pause } from "./pause";
import { answers } from "./ply";
import type { Scene } from "./scene_data";
import { SELECTED, type Color } from "./shader";
import type { ShownQuery } from "./splat";
import type { State } from "./state";

/** Gaussians between two looks at the clock. */
const AT_A_TIME = 1000;
/** After which the browser may do something else. */
const WORK_SECONDS = 0.02;

/** What has one line around it, and its colour. */
type Group = [isIn: (gaussian: number) => boolean, color: Color];

export class SelectionOutline {
  private readonly canvas = byId<HTMLCanvasElement>("outlines");
  private selection = "";
  private of: Scene | null = null;
  /** Counts what makes the lines wrong. */
  private changes = 0;
  private drawing = false;
  private moving = false;

  /**
   * @param scene what the page shows now, which may be a coarse one at first
   * @param rest once the camera rests and its picture is drawn
   */
  constructor(
    private readonly scene: () => Scene,
    private readonly rest: () => Promise<void>,
    private readonly eye: Eye,
    private readonly state: State,
    private readonly picture: HTMLElement,
  ) {}

  /** Something else may be selected. */
  changed(): void {
    const { things } = this.state;
    const texts = this.texts().map(({ text, level, threshold, things, color }) => [text, level, threshold, things, color]);
    const selection = JSON.stringify([texts, this.clicked(), [...(things?.hidden ?? [])]]);
    const scene = this.scene();
    if (selection === this.selection && scene === this.of) return;
    [this.selection, this.of] = [selection, scene];
    this.again();
  }

  /** The camera has moved, and the stage knows: no lines until it rests. */
  async moved(): Promise<void> {
    this.canvas.hidden = true;
    this.changes += 1;
    if (this.moving) return;
    this.moving = true;
    await this.rest();
    this.moving = false;
    this.again();
  }

  /** Once all lines are drawn. */
  async drawn(): Promise<void> {
    while (this.moving || this.drawing) await pause(0.01);
  }

  /** Draw the lines on a picture that was taken of the scene. */
  drawOn(picture: HTMLCanvasElement): void {
    if (this.canvas.hidden) return;
    picture.getContext("2d", { willReadFrequently: true })!.drawImage(this.canvas, 0, 0, picture.width, picture.height);
  }

  private again(): void {
    this.changes += 1;
    if (!this.drawing && !this.moving) void this.draw();
  }

  private texts(): ShownQuery[] {
    return ["colour", "heat"].includes(this.state.mode) ? this.state.shown() : [];
  }

  private clicked(): number[] {
    return ["only", "except"].includes(this.state.mode) ? [] : (this.state.things?.selected ?? []);
  }

  private groups(scene: Scene): Group[] {
    const things = this.state.things!;
    return [
      ...this.texts().map((query): Group => [answers(scene, query), query.color]),
      ...this.clicked().map((number): Group => [(i) => scene.owner(i, things.of(number).level) === number, SELECTED]),
    ];
  }

  /** Draw the lines, again if something changes meanwhile. */
  private async draw(): Promise<void> {
    this.drawing = true;
    let change;
    do {
      change = this.changes;
      const lines: [Silhouette, Color][] = [];
      for (const [isIn, color] of this.groups(this.scene())) lines.push([await this.silhouette(isIn, change), color]);
      if (change !== this.changes) continue;
      this.canvas.hidden = !lines.length;
      for (const [at, [silhouette, color]] of lines.entries()) {
        if (!at) silhouette.prepare(this.canvas);
        silhouette.outline(this.canvas, color);
      }
    } while (change !== this.changes && !this.moving);
    this.drawing = false;
  }

  /** Of the Gaussians that are in; of some of them once something has changed. */
  private async silhouette(isIn: Group[0], change: number): Promise<Silhouette> {
    const [scene, { things }] = [this.scene(), this.state];
    const silhouette = new Silhouette(this.eye, this.picture);
    let begun = performance.now();
    for (let start = 0; start < scene.count && change === this.changes; start += AT_A_TIME) {
      const members = [];
      for (let i = start; i < Math.min(start + AT_A_TIME, scene.count); i++) if (isIn(i) && !things?.hides(scene, i)) members.push(i);
      silhouette.add(scene, members);
      if (performance.now() - begun < WORK_SECONDS * 1000) continue;
      await pause(0);
      begun = performance.now();
    }
    return silhouette;
  }
}
