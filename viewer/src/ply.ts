// A selection as a splat, in a page that has no server: standard 3DGS PLY of what the page holds.
import type { Scene } from "./scene_data";
import type { ShownQuery } from "./splat";

const SH_C0 = 0.28209479177387814;
const PROPERTIES = [
  "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
  "rot_0", "rot_1", "rot_2", "rot_3",
];

/** Whether a Gaussian's votes answer a query: the same sums as in the shader. */
function votes(scene: Scene, i: number, query: ShownQuery): boolean {
  const { level } = query;
  let own = 0;
  let coded = false;
  const phrases = new Float64Array(scene.phrases);
  const canonical = scene.tensor("canonical").data;
  for (let k = 0; k < scene.k; k++) {
    const weight = scene.weight(i, level, k);
    if (!weight) continue;
    coded = true;
    const atom = scene.atom(i, level, k);
    own += weight * query.scores[level * scene.atoms + atom];
    for (let p = 0; p < scene.phrases; p++) {
      phrases[p] += weight * canonical[(level * scene.phrases + p) * scene.atoms + atom];
    }
  }
  if (!coded) return false;
  const relevancy = 1 / (1 + Math.exp(-10 * (own - Math.max(...phrases))));
  const [low, high] = query.span;
  return high - low > 1e-6 && (relevancy - low) / (high - low) > query.threshold;
}

/** Gaussians of any of some things, or all others. */
export function owned(scene: Scene, numbers: number[], rest: boolean): number[] {
  const things = new Set(numbers);
  const levels = [...scene.metadata.levels.keys()];
  return rowsOf(scene, (i) => levels.some((level) => things.has(scene.owner(i, level))) !== rest);
}

function rowsOf(scene: Scene, isIn: (i: number) => boolean): number[] {
  const rows = [];
  for (let i = 0; i < scene.count; i++) if (isIn(i)) rows.push(i);
  return rows;
}

/** Whether a Gaussian answers a query. */
export function answers(scene: Scene, query: ShownQuery): (i: number) => boolean {
  if (!query.things) return (i) => votes(scene, i, query);
  const [things, without] = [new Set(query.things), new Set(query.without)];
  const levels = [...scene.metadata.levels.keys()];
  const isOf = (i: number, numbers: Set<number>) => levels.some((level) => numbers.has(scene.owner(i, level)));
  return (i) => isOf(i, things) && !isOf(i, without);
}

/** Gaussians that answer any query, or all others. */
export function selected(scene: Scene, queries: ShownQuery[], rest: boolean): number[] {
  const answering = queries.map((query) => answers(scene, query));
  return rowsOf(scene, (i) => answering.some((isAnswer) => isAnswer(i)) !== rest);
}

/** @param comments lines of the header */
export function plyOf(scene: Scene, rows: number[], comments: string[]): Blob {
  const lines = PROPERTIES.map((name) => `property float ${name}`).join("\n");
  const said = comments.map((line) => `comment ${line}\n`).join("");
  const header = `ply\nformat binary_little_endian 1.0\n${said}element vertex ${rows.length}\n${lines}\nend_header\n`;
  const values = new Float32Array(rows.length * PROPERTIES.length);
  const mean = { x: 0, y: 0, z: 0 };
  rows.forEach((i, row) => {
    scene.mean(i, mean);
    const colors = [0, 1, 2].map((channel) => (scene.color(i, channel) - 0.5) / SH_C0);
    // Opacities of 0 and 1 have no finite logit.
    const opacity = Math.min(1 - 1e-6, Math.max(1e-6, scene.opacity(i)));
    const scales = [0, 1, 2].map((axis) => Math.log(scene.scale(i, axis)));
    const logit = Math.log(opacity / (1 - opacity));
    values.set([mean.x, mean.y, mean.z, 0, 0, 0, ...colors, logit, ...scales, ...scene.quat(i)], row * PROPERTIES.length);
  });
  return new Blob([header, values], { type: "application/octet-stream" });
}
