// Where the scene is seen: by WebGL in this browser, or as pictures of the server.
import * as THREE from "three";
import { Boxes } from "./boxes";
import type { Eye } from "./camera";
import { pause } from "./pause";
import type { Progress } from "./safetensors";
import type { Scene } from "./scene_data";
import { patiently, type LiveServer } from "./server";
import { Splat } from "./splat";
import type { State } from "./state";

export interface Stage {
  /** Show texts and settings as they are now. */
  update(): void;
  /** Draw again soon: the camera or the size has changed. */
  redraw(): void;
  /** Once all that was asked for is drawn. */
  drawn(): Promise<void>;
  /** What is seen, [W x H] RGBA. */
  snapshot(): HTMLCanvasElement;
}

const REST_SECONDS = 0.25;
/** If two frames in a row take longer, pictures are small and coarse while the camera moves. */
const SLOW_SECONDS = 0.2;
const MOVING_SCALE = 0.5;

/**
 * Pictures a second are bounded by the screen; none is drawn without need.
 *
 * Fast browsers draw with the order of the last sorting and sort meanwhile. Slow ones do so only while the camera moves;
 * when it rests they sort first and draw once.
 */
export class SplatStage implements Stage {
  private readonly renderer: THREE.WebGLRenderer;
  private splat: Splat | null = null;
  /** Few Gaussians of the same scene, where it is large. */
  private coarse: Splat | null = null;
  /** Of the last frame. */
  private shown: Splat | null = null;
  private readonly boxes: Boxes;
  private wanted = false;
  /** Whether something has changed since the last sorting at rest. */
  private stale = true;
  private settling = false;
  /** The timer that ends a movement of the camera; 0 while it rests. */
  private moving = 0;
  /** In a row; two are slow enough. */
  private slowFrames = 0;
  /** Frames that the browser still draws. */
  private unfinished = 0;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly eye: Eye,
    private readonly state: State,
    onError: (sentence: string) => void,
  ) {
    canvas.addEventListener("webglcontextlost", () => onError("The browser has lost its GPU context: reload the page."));
    // Without antialias, as Spark advises.
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: false });
    this.renderer.setClearColor(0x000000, 1);
    this.boxes = new Boxes(eye.world);
  }

  /** Show a scene. */
  async load(scene: Scene, progress: Progress): Promise<void> {
    const splat = this.splatOf(scene);
    await splat.add(scene, progress);
    this.splat = splat;
    this.update();
  }

  /**
   * Show a part of the scene in place of the Gaussians that stand for it.
   *
   * @param pieces what is shown before the first part comes; drawn while the camera moves from then on
   */
  async swap(part: Scene, instead: Scene, pieces: Scene[]): Promise<void> {
    let splat = this.splat!;
    if (!this.coarse) {
      splat = this.splatOf(part);
      for (const piece of pieces) await splat.add(piece, () => {});
    }
    await splat.add(part, () => {}, [instead]);
    this.coarse ??= this.splat;
    this.splat = splat;
    this.update();
  }

  private splatOf(scene: Scene): Splat {
    return new Splat(scene, this.renderer, (splat) => {
      if (splat === this.shown) this.soon();
    });
  }

  /** How many Gaussians the last frame has. */
  get drawing(): number {
    return this.shown?.count ?? 0;
  }

  update(): void {
    const { things, measured } = this.state;
    for (const splat of [this.splat, this.coarse]) splat?.update(this.state.shown(), this.state.look());
    this.boxes.update(things ? things.selected.map((number) => things.of(number)) : [], measured ?? []);
    this.stale = true;
    this.soon();
  }

  redraw(): void {
    this.move();
    this.stale = true;
    this.soon();
  }

  /**
   * The camera rests a while after its last movement and the frame that shows it: the browser hands over no movement
   * while it draws. Other frames do not count, for sorting causes some.
   */
  private move(): void {
    clearTimeout(this.moving);
    this.moving = window.setTimeout(() => {
      if (this.unfinished) return; // whose end is waited for
      this.moving = 0;
      this.soon();
    }, REST_SECONDS * 1000);
  }

  private soon(): void {
    if (this.wanted) return;
    this.wanted = true;
    requestAnimationFrame(() => {
      this.wanted = false;
      this.frame();
    });
  }

  private frame(): void {
    const { splat, isHasty, isSlow } = this;
    if (!splat) return;
    if (!isHasty && (isSlow ? this.stale : this.shown && this.shown !== splat)) void this.settle(splat);
    if (isHasty) this.draw(this.coarse ?? splat);
    else if (!isSlow) this.draw(this.shown ?? splat);
    else if (!this.settling) this.draw(splat);
    else return;
    void this.clock();
  }

  /** Sort all Gaussians, then draw them, unless the camera moves again. */
  private async settle(splat: Splat): Promise<void> {
    if (this.settling) return;
    this.settling = true;
    this.stale = false;
    await splat.sort(this.eye.camera);
    this.settling = false;
    if (!this.isHasty) this.shown = splat;
    this.soon();
  }

  /** Wait for a frame, and find whether frames are too slow for whole pictures; that lasts, as the browser stays the same. */
  private async clock(): Promise<void> {
    const gl = this.renderer.getContext() as WebGL2RenderingContext;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    if (!fence) return;
    gl.flush();
    const isAlone = this.unfinished === 0;
    this.unfinished += 1;
    const begun = performance.now();
    while (gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.UNSIGNALED) await pause(0.02);
    gl.deleteSync(fence);
    this.unfinished -= 1;
    if (this.moving && !this.unfinished) this.move();
    if (this.isSlow || !isAlone) return;
    // The first frame alone may wait for programs and textures.
    this.slowFrames = performance.now() - begun > SLOW_SECONDS * 1000 ? this.slowFrames + 1 : 0;
  }

  private get isSlow(): boolean {
    return this.slowFrames >= 2;
  }

  private get isHasty(): boolean {
    return this.moving !== 0 && this.isSlow;
  }

  async drawn(): Promise<void> {
    while (this.wanted || this.moving || this.settling || this.shown?.isSorting || this.shown?.spark.dirty) await pause(0.01);
  }

  snapshot(): HTMLCanvasElement {
    if (this.shown) this.draw(this.shown); // in the same task: the browser clears the buffer after it
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [this.canvas.width, this.canvas.height];
    copy.getContext("2d", { willReadFrequently: true })!.drawImage(this.canvas, 0, 0);
    return copy;
  }

  private draw(splat: Splat): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const ratio = Math.min(window.devicePixelRatio, 2) * (this.isHasty ? MOVING_SCALE : 1);
    const size = this.renderer.getSize(new THREE.Vector2());
    if (size.x !== width || size.y !== height || this.renderer.getPixelRatio() !== ratio) {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
      this.eye.resize(width, height);
    }
    this.shown = splat;
    splat.spark.autoUpdate = this.isHasty || !this.isSlow;
    splat.world.add(this.boxes.lines);
    this.renderer.render(splat.world, this.eye.camera);
  }
}

/** Pictures of the server, one after another: small while the camera moves, whole when it rests. */
export class RemoteStage implements Stage {
  private moved = 0;
  private shown = -1;
  private busy: Promise<void> | null = null;
  private readonly context: CanvasRenderingContext2D;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly eye: Eye,
    private readonly state: State,
    private readonly server: LiveServer,
    private readonly onError: (sentence: string) => void,
  ) {
    this.context = canvas.getContext("2d", { willReadFrequently: true })!;
  }

  update(): void {
    this.redraw();
  }

  redraw(): void {
    this.moved += 1;
    this.busy ??= this.stream().finally(() => {
      this.busy = null;
    });
  }

  async drawn(): Promise<void> {
    while (this.busy) await this.busy;
  }

  snapshot(): HTMLCanvasElement {
    return this.canvas;
  }

  /** Until the newest state is shown whole. */
  private async stream(): Promise<void> {
    while (this.shown !== this.moved) {
      const before = this.moved;
      await this.show(MOVING_SCALE, 70);
      if (this.moved !== before) continue; // still moving: the next picture at once
      await pause(REST_SECONDS);
      if (this.moved !== before) continue;
      await this.show(1, 90);
      if (this.moved === before) this.shown = before;
    }
  }

  private async show(scale: number, quality: number): Promise<void> {
    const width = Math.max(1, Math.round(this.canvas.clientWidth * scale));
    const height = Math.max(1, Math.round(this.canvas.clientHeight * scale));
    this.eye.resize(width, height);
    try {
      const picture = () => this.server.picture(this.state.picture(this.eye.record(width, height), quality));
      const blob = await patiently(picture, REST_SECONDS);
      const bitmap = await createImageBitmap(blob);
      [this.canvas.width, this.canvas.height] = [width, height];
      this.context.drawImage(bitmap, 0, 0);
      bitmap.close();
    } catch (error) {
      this.onError((error as Error).message);
      this.shown = this.moved; // until something changes
    }
  }
}
