// The parts of a large scene: which is loaded next, and which is shown whole.
import type { Source } from "./answers";
import { pause } from "./pause";
import type { Packed } from "./safetensors";
import { Scene, type CameraRecord } from "./scene_data";
import { NotNow } from "./server";

/** Until a part is asked for again. */
const AGAIN_SECONDS = 1;
/** Merged Gaussians that cover more pixels each, side by side, are worth unmerging. */
const LARGE_PIXELS = 4;

/** Shows a part in place of another. */
type Swap = (part: Scene, instead: Scene) => Promise<void>;

/** A large scene in parts, of each of which something is shown at any time. */
export class Parts {
  /** Few Gaussians that stand for each. */
  readonly coarse: Scene[];
  /** What is shown of each. */
  private readonly shown: Scene[];
  /** The merged ones that are not shown, for whole ones are. */
  private readonly merged = new Map<number, Scene>();

  /** @param first the scene as it is shown before its parts come */
  constructor(private readonly first: Scene, private readonly source: Source, private readonly swap: Swap) {
    this.coarse = first.coarseParts();
    this.shown = [...this.coarse];
  }

  /** All that is shown. */
  joined(): Scene {
    return Scene.joined(this.shown);
  }

  /** Load all parts, and return whether there are any. Next is the one that covers most of the picture. */
  async load(camera: () => CameraRecord): Promise<boolean> {
    const left = new Set(this.shown.keys());
    while (left.size) {
      const [[number]] = this.bySight(left, camera());
      await this.show(number, await this.part(number));
      left.delete(number);
    }
    return this.shown.length > 0;
  }

  /**
   * Show parts whole whose merged Gaussians are large in the picture, as many as there is room for; those that were whole
   * before make room.
   *
   * @param most Gaussians of all whole parts
   * @returns whether anything has changed
   */
  async unmerge(camera: () => CameraRecord, most: number): Promise<boolean> {
    const { shown, merged } = this;
    const room = Math.max(1, Math.floor((most * shown.length) / this.first.metadata.n_gaussians));
    for (let changed = false; ; changed = true) {
      const wanted = this.bySight(shown.keys(), camera())
        .filter(([number, pixels]) => pixels > LARGE_PIXELS * (merged.get(number) ?? shown[number]).count)
        .slice(0, room)
        .map(([number]) => number);
      const next = wanted.find((number) => !merged.has(number));
      if (next === undefined) return changed;
      const whole = await this.part(next, true);
      const gone = merged.size < room ? undefined : [...merged.keys()].find((number) => !wanted.includes(number));
      if (gone !== undefined) {
        await this.show(gone, merged.get(gone)!);
        merged.delete(gone);
      }
      merged.set(next, shown[next]);
      await this.show(next, whole);
    }
  }

  private async show(number: number, part: Scene): Promise<void> {
    await this.swap(part, this.shown[number]);
    this.shown[number] = part;
  }

  private async part(number: number, whole = false): Promise<Scene> {
    return this.first.part(await patiently(() => this.source.part(number, this.shown.length, whole)));
  }

  /** Parts and the pixels that they cover, most first. */
  private bySight(numbers: Iterable<number>, camera: CameraRecord): [number, number][] {
    const covers = [...numbers].map((number): [number, number] => [number, cover(this.coarse[number], camera)]);
    return covers.sort(([, a], [, b]) => b - a);
  }
}

/** What is asked for, once the server has time for it or answers again. */
async function patiently(ask: () => Promise<Packed>): Promise<Packed> {
  for (;;) {
    try {
      return await ask();
    } catch (error) {
      if (!(error instanceof NotNow)) throw error;
      await pause(AGAIN_SECONDS);
    }
  }
}

/** Pixels that Gaussians would cover side by side. */
function cover(scene: Scene, { viewmat: V, K, width, height }: CameraRecord): number {
  const mean = { x: 0, y: 0, z: 0 };
  let pixels = 0;
  for (let i = 0; i < scene.count; i++) {
    scene.mean(i, mean);
    const [x, y, z] = [0, 4, 8].map((row) => V[row] * mean.x + V[row + 1] * mean.y + V[row + 2] * mean.z + V[row + 3]);
    if (z <= 0 || Math.abs((K[0] * x) / z) > width / 2 || Math.abs((K[4] * y) / z) > height / 2) continue;
    const sizes = [0, 1, 2].map((axis) => scene.scale(i, axis)).sort((a, b) => b - a);
    pixels += Math.min(width * height, scene.opacity(i) * sizes[0] * sizes[1] * (K[0] / z) ** 2);
  }
  return pixels;
}
