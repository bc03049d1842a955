// The parts of a large scene: which is loaded next, and which is shown whole.
import type { Source } from "./answers";
import { Scene, type CameraRecord } from "./scene_data";
import { patiently } from "./server";

/** Until a part is asked for again. */
const AGAIN_SECONDS = 1;
/** What merged Gaussians cover in the picture, each, from which on they are worth unmerging. */
const LARGE_PIXELS = 2;

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
  /** Those that cannot be had whole. */
  private readonly missing = new Set<number>();
  private all: Scene | null = null;

  /** @param first the scene as it is shown before its parts come */
  constructor(private readonly first: Scene, private readonly source: Source, private readonly swap: Swap) {
    this.coarse = first.coarseParts();
    this.shown = [...this.coarse];
  }

  /** All that is shown; the same scene until that changes. */
  joined(): Scene {
    return (this.all ??= Scene.joined(this.shown));
  }

  /** Load all parts. Next is the one that covers most of the picture. */
  async load(camera: () => CameraRecord): Promise<void> {
    const left = new Set(this.shown.keys());
    while (left.size) {
      const [{ number }] = this.bySight(left, camera());
      await this.show(number, await this.part(number));
      left.delete(number);
    }
  }

  /**
   * Show parts whole whose merged Gaussians are large in the picture, as many as there is room for; those that were whole
   * before make room.
   *
   * @param rest once the camera rests
   * @param most Gaussians of all whole parts
   */
  async unmerge(rest: () => Promise<void>, camera: () => CameraRecord, most: number): Promise<void> {
    const { shown, merged } = this;
    const room = Math.floor((most * shown.length) / this.first.metadata.n_gaussians);
    for (;;) {
      await rest();
      const next = this.near(camera(), room).find((number) => !merged.has(number));
      if (next === undefined) return;
      this.missing.add(next); // asked for once, if that fails
      const part = await this.part(next, true);
      this.missing.delete(next);
      const wanted = this.near(camera(), room);
      if (!wanted.includes(next)) continue; // the camera has gone elsewhere
      const gone = [...merged.keys()].find((number) => !wanted.includes(number));
      if (gone !== undefined && merged.size === room) {
        await this.show(gone, merged.get(gone)!);
        merged.delete(gone);
      }
      const before = shown[next];
      await this.show(next, part);
      merged.set(next, before);
    }
  }

  /** The parts whose merged Gaussians are large in the picture, as many as there is room for. */
  private near(camera: CameraRecord, room: number): number[] {
    const large = this.bySight(this.shown.keys(), camera).filter(({ number, seen, pixels }) => {
      if (this.missing.has(number)) return false;
      // Each of the coarse ones, which are seen, stands for so many merged ones.
      const each = (this.merged.get(number) ?? this.shown[number]).count / this.coarse[number].count;
      return pixels > LARGE_PIXELS * each * seen;
    });
    return large.slice(0, room).map(({ number }) => number);
  }

  private async show(number: number, part: Scene): Promise<void> {
    await this.swap(part, this.shown[number]);
    this.shown[number] = part;
    this.all = null;
  }

  private async part(number: number, whole = false): Promise<Scene> {
    return this.first.part(await patiently(() => this.source.part(number, this.shown.length, whole), AGAIN_SECONDS));
  }

  /** What parts cover of the picture, most first. */
  private bySight(numbers: Iterable<number>, camera: CameraRecord): Sight[] {
    return [...numbers].map((number) => sightOf(number, this.coarse[number], camera)).sort((a, b) => b.pixels - a.pixels);
  }
}

/** What a picture has of a part. */
interface Sight {
  number: number;
  /** Coarse Gaussians. */
  seen: number;
  /** Which they would cover side by side. */
  pixels: number;
}

function sightOf(number: number, scene: Scene, { viewmat: V, K, width, height }: CameraRecord): Sight {
  const mean = { x: 0, y: 0, z: 0 };
  let [seen, pixels] = [0, 0];
  for (let i = 0; i < scene.count; i++) {
    scene.mean(i, mean);
    const z = V[8] * mean.x + V[9] * mean.y + V[10] * mean.z + V[11];
    if (z <= 0) continue;
    const [a, b, c] = [scene.scale(i, 0), scene.scale(i, 1), scene.scale(i, 2)];
    const margin = 3 * Math.max(a, b, c);
    const x = Math.abs(V[0] * mean.x + V[1] * mean.y + V[2] * mean.z + V[3]) - margin;
    const y = Math.abs(V[4] * mean.x + V[5] * mean.y + V[6] * mean.z + V[7]) - margin;
    if ((K[0] * x) / z > width / 2 || (K[4] * y) / z > height / 2) continue;
    const twoLargest = (a * b * c) / Math.min(a, b, c);
    seen += 1;
    pixels += Math.min(width * height, scene.opacity(i) * twoLargest * (K[0] / z) ** 2);
  }
  return { number, seen, pixels };
}
