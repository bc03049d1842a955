// The parts of a large scene: which is loaded next.
import type { Source } from "./answers";
import { pause } from "./pause";
import type { Packed } from "./safetensors";
import type { CameraRecord, Scene } from "./scene_data";
import { NotNow } from "./server";

/** Until a part is asked for again. */
const AGAIN_SECONDS = 1;

/**
 * All parts with their numbers. Next is the one that covers most of the picture.
 *
 * @param coarse Gaussians that stand for each part
 */
export async function* partsBySight(
  coarse: Scene[], source: Source, camera: () => CameraRecord,
): AsyncGenerator<[number, Packed]> {
  const left = new Set(coarse.keys());
  while (left.size) {
    const number = mostSeen(coarse, left, camera());
    yield [number, await patiently(() => source.part(number, coarse.length))];
    left.delete(number);
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

function mostSeen(coarse: Scene[], left: Set<number>, camera: CameraRecord): number {
  let [best, most] = [-1, -1];
  for (const number of left) {
    const covered = cover(coarse[number], camera);
    if (covered > most) [best, most] = [number, covered];
  }
  return best;
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
