// The splat on the GPU: Gaussians by Spark, codes and queries as textures that our shader reads.
import { dyno, ExtSplats, SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
import * as THREE from "three";
import { World } from "./camera";
import { pause } from "./pause";
import type { Progress } from "./safetensors";
import { NO_OWNER, type Scene } from "./scene_data";
import { body, BY_THINGS, functions, MARKS, MODES, MOST_QUERIES, WIDTH, type Color, type Inputs, type Mode } from "./shader";

/** Gaussians between two moments in which the browser may draw. */
const AT_A_TIME = 40000;

/** A query as the shader takes it. */
export interface ShownQuery {
  text: string;
  /** [S, L] inner products of atoms and text. */
  scores: Float32Array;
  /** Level that answers. */
  level: number;
  threshold: number;
  /** Numbers of the things that answer; null where relevancy above the threshold does. */
  things: number[] | null;
  /** Numbers of things whose Gaussians do not answer. */
  without: number[];
  span: [number, number];
  /** 0..1. */
  color: Color;
}

export interface Look {
  mode: Mode;
  /** Of codes and confidence. */
  level: number;
  opacity: number;
  /** Numbers of things. */
  selected: number[];
  hidden: Iterable<number>;
  /** Leave haze and needles out of what is shown alone. */
  clean: boolean;
}

/** What the shader reads of each Gaussian of a piece. */
type Textures = Record<"indices" | "weights" | "owners" | "confidence", THREE.DataTexture>;

/**
 * A scene that is drawn, in one piece or several; `update` changes only small textures and numbers.
 *
 * Each has a renderer of Spark: one for two scenes would generate and sort all Gaussians whenever the other one is shown,
 * and draw the one before meanwhile.
 */
export class Splat {
  readonly world = new THREE.Scene();
  readonly spark: SparkRenderer;
  private readonly pieces = new Map<Scene, { mesh: SplatMesh; textures: Textures }>();
  private readonly canonical: THREE.DataTexture;
  private readonly codeColors: THREE.DataTexture;
  private readonly scores: THREE.DataTexture;
  private readonly queries: THREE.DataTexture;
  /** Bits of each thing: bit q says that query q selects it, bit 16 + q that it leaves it out; others are `MARKS`. */
  private readonly things: THREE.DataTexture;
  private readonly mode = dyno.dynoInt(0);
  private readonly level = dyno.dynoInt(0);
  private readonly opacity = dyno.dynoFloat(1);
  private readonly anySelected = dyno.dynoInt(0);
  private readonly clean = dyno.dynoInt(0);

  /**
   * @param scene what its pieces have in common
   * @param onDirty called when another frame would show more, as after sorting
   */
  constructor(private readonly scene: Scene, renderer: THREE.WebGLRenderer, onDirty: (splat: Splat) => void) {
    this.canonical = canonicalTexture(scene);
    this.codeColors = codeColorTexture(scene);
    this.spark = sparkOf(renderer, () => onDirty(this));
    this.scores = floats(scene.atoms, (scene.levels * MOST_QUERIES) / 4);
    this.queries = floats(MOST_QUERIES, 2);
    const rows = Math.max(1, Math.ceil((scene.metadata.n_things ?? 0) / WIDTH));
    this.things = integers(new Uint32Array(WIDTH * rows), rows, THREE.UnsignedIntType, "R32UI");
    this.world.add(this.spark);
    this.update([], { mode: "colour", level: 0, opacity: 1, selected: [], hidden: [], clean: false });
  }

  /** Draw a piece, with progress, in place of others. */
  async add(scene: Scene, progress: Progress, instead: Scene[] = []): Promise<void> {
    const splats = new ExtSplats({ maxSplats: scene.count });
    await splats.initialized;
    const centre = new THREE.Vector3();
    const scales = new THREE.Vector3();
    const quaternion = new THREE.Quaternion();
    const color = new THREE.Color();
    const world = new World(scene.metadata);
    const unit = world.lengthToPage(1);
    for (let i = 0; i < scene.count; i++) {
      scene.mean(i, centre);
      world.toPage(centre);
      scales.set(scene.scale(i, 0), scene.scale(i, 1), scene.scale(i, 2)).multiplyScalar(unit);
      const [w, x, y, z] = scene.quat(i);
      quaternion.set(x, y, z, w);
      // Not by setRGB, which would convert from sRGB: colours stay as they are trained.
      color.r = scene.color(i, 0);
      color.g = scene.color(i, 1);
      color.b = scene.color(i, 2);
      splats.pushSplat(centre, scales, quaternion, scene.opacity(i), color);
      if (i % AT_A_TIME === AT_A_TIME - 1) {
        progress("unpacking", i, scene.count);
        await pause(0);
      }
    }
    // Textures are made of whole arrays only.
    const { extArrays } = splats;
    const mesh = new SplatMesh({ extSplats: new ExtSplats({ extArrays, numSplats: scene.count }) });
    const textures = texturesOf(scene);
    mesh.objectModifier = this.modifier(scene, textures);
    await mesh.initialized;
    mesh.updateGenerator();
    for (const piece of instead) this.remove(piece);
    this.pieces.set(scene, { mesh, textures });
    this.world.add(mesh);
  }

  private remove(scene: Scene): void {
    const { mesh, textures } = this.pieces.get(scene)!;
    this.pieces.delete(scene);
    this.world.remove(mesh);
    mesh.dispose();
    for (const texture of Object.values(textures)) {
      texture.dispose();
      texture.source.data = null; // materials, which live on, would keep it
    }
  }

  get count(): number {
    return [...this.pieces.keys()].reduce((sum, { count }) => sum + count, 0);
  }

  get isSorting(): boolean {
    return this.spark.sorting || this.spark.sortDirty;
  }

  /** Sort for a camera before anything is drawn for it. */
  async sort(camera: THREE.Camera): Promise<void> {
    await this.spark.update({ scene: this.world, camera });
    while (this.isSorting) await pause(0.01); // one that began before
  }

  /** Show other queries, or the same in another way. */
  update(shown: ShownQuery[], look: Look): void {
    const { levels, atoms } = this.scene;
    const queries = this.queries.image.data as unknown as Float32Array;
    const things = this.things.image.data as unknown as Uint32Array;
    things.fill(0);
    for (let q = 0; q < MOST_QUERIES; q++) {
      const query = shown[q];
      const cut = query?.things ? BY_THINGS : query?.threshold;
      queries.set(query ? [...query.color, query.level] : [0, 0, 0, -1], 4 * q);
      queries.set(query ? [...query.span, cut, shown.length] : [0, 0, 0, 0], 4 * (MOST_QUERIES + q));
      if (!query) continue;
      for (const thing of query.things ?? []) things[thing] |= 1 << q;
      for (const thing of query.without) things[thing] |= 1 << (16 + q);
      for (let level = 0; level < levels; level++) {
        write(this.scores, (level * MOST_QUERIES) / 4 + (q >> 2), q & 3, query.scores.subarray(level * atoms, (level + 1) * atoms));
      }
    }
    for (const thing of look.selected) things[thing] |= MARKS.selected;
    for (const thing of look.hidden) things[thing] |= MARKS.hidden;
    this.anySelected.value = look.selected.length;
    this.clean.value = Number(look.clean);
    this.scores.needsUpdate = this.queries.needsUpdate = this.things.needsUpdate = true;
    this.mode.value = MODES.indexOf(look.mode);
    this.level.value = look.level;
    this.opacity.value = look.opacity;
    for (const { mesh } of this.pieces.values()) mesh.updateVersion();
  }

  private modifier(scene: Scene, { indices, weights, owners, confidence }: Textures) {
    const sizes = { levels: scene.levels, k: scene.k, phrases: scene.phrases, things: scene.metadata.n_things ?? 0 };
    const uniforms = {
      indices: dyno.dynoUsampler2D(indices),
      weights: dyno.dynoUsampler2D(weights),
      scale: dyno.dynoFloat(scene.metadata.weights_scale / 65535),
      canonical: dyno.dynoSampler2D(this.canonical),
      scores: dyno.dynoSampler2D(this.scores),
      queries: dyno.dynoSampler2D(this.queries),
      owners: dyno.dynoUsampler2D(owners),
      things: dyno.dynoUsampler2D(this.things),
      confidence: dyno.dynoSampler2D(confidence),
      codeColors: dyno.dynoSampler2D(this.codeColors),
      mode: this.mode,
      level: this.level,
      opacity: this.opacity,
      anySelected: this.anySelected,
      clean: this.clean,
    };
    type Types = { [Name in keyof typeof uniforms]: (typeof uniforms)[Name]["type"] };
    const types = Object.fromEntries(Object.entries(uniforms).map(([name, { type }]) => [name, type])) as Types;
    const inTypes = { gsplat: dyno.Gsplat, ...types } as const;
    return dyno.dynoBlock({ gsplat: dyno.Gsplat }, { gsplat: dyno.Gsplat }, ({ gsplat }) => {
      const colored = new dyno.Dyno({
        inTypes,
        outTypes: { gsplat: dyno.Gsplat },
        globals: () => [functions(sizes)],
        statements: ({ inputs, outputs }) =>
          dyno.unindentLines(`{${body(inputs as unknown as Inputs, outputs.gsplat as string, sizes)}}`),
      });
      return { gsplat: colored.apply({ gsplat, ...uniforms }).gsplat };
    });
  }
}

/** Renders a scene with Spark. */
function sparkOf(renderer: THREE.WebGLRenderer, onDirty: () => void): SparkRenderer {
  // As Inria's rasteriser: 0.3 pixels are added to the diagonal of each projected covariance.
  return new SparkRenderer({ renderer, onDirty, preBlurAmount: 0.3, blurAmount: 0, maxStdDev: 3 });
}

function floats(width: number, height: number): THREE.DataTexture {
  const texture = new THREE.DataTexture(
    new Float32Array(4 * width * height), width, height, THREE.RGBAFormat, THREE.FloatType);
  texture.needsUpdate = true;
  return texture;
}

/** Write a row of one of the four channels. */
function write(texture: THREE.DataTexture, row: number, channel: number, numbers: ArrayLike<number>): void {
  const { data, width } = texture.image as unknown as { data: Float32Array; width: number };
  for (let i = 0; i < numbers.length; i++) data[4 * (row * width + i) + channel] = numbers[i];
}

function texturesOf(scene: Scene): Textures {
  return { ...codeTextures(scene), owners: ownerTexture(scene), confidence: confidenceTexture(scene) };
}

/** Indices and weights, four atoms a texel. */
function codeTextures(scene: Scene): Pick<Textures, "indices" | "weights"> {
  const { count, levels, k } = scene;
  const blocks = Math.ceil(k / 4);
  const height = Math.max(1, Math.ceil((count * levels * blocks) / WIDTH));
  const source = { indices: scene.tensor("code_indices").data, weights: scene.tensor("code_weights").data };
  const isByte = source.indices instanceof Uint8Array;
  const indices = isByte ? new Uint8Array(4 * WIDTH * height) : new Uint16Array(4 * WIDTH * height);
  const weights = new Uint16Array(4 * WIDTH * height);
  for (let level = 0; level < levels; level++) {
    for (let part = 0; part < k; part++) {
      const from = (level * k + part) * count;
      for (let i = 0; i < count; i++) {
        const to = 4 * blocks * (i * levels + level) + part;
        indices[to] = source.indices[from + i];
        weights[to] = source.weights[from + i];
      }
    }
  }
  return {
    indices: integers(indices, height, isByte ? THREE.UnsignedByteType : THREE.UnsignedShortType, isByte ? "RGBA8UI" : "RGBA16UI"),
    weights: integers(weights, height, THREE.UnsignedShortType, "RGBA16UI"),
  };
}

function integers(
  data: Uint8Array<ArrayBuffer> | Uint16Array<ArrayBuffer> | Uint32Array<ArrayBuffer>,
  height: number,
  type: THREE.TextureDataType,
  format: THREE.PixelFormatGPU,
): THREE.DataTexture {
  const layout = format.startsWith("RGBA") ? THREE.RGBAIntegerFormat : THREE.RedIntegerFormat;
  const texture = new THREE.DataTexture(data, WIDTH, height, layout, type);
  texture.internalFormat = format;
  texture.needsUpdate = true;
  return texture;
}

/** Scores of the canonical phrases: rows of four phrases, level by level. */
function canonicalTexture(scene: Scene): THREE.DataTexture {
  const { levels, atoms, phrases } = scene;
  const groups = Math.max(1, Math.ceil(phrases / 4));
  const texture = floats(atoms, levels * groups);
  for (let line = 0; line < levels * phrases; line++) {
    const [level, phrase] = [Math.floor(line / phrases), line % phrases];
    const scores = scene.tensor("canonical").data.subarray(line * atoms, (line + 1) * atoms);
    write(texture, level * groups + (phrase >> 2), phrase & 3, scores);
  }
  return texture;
}

/** The thing of each Gaussian at each level; one row of none where the scene has no things. */
function ownerTexture(scene: Scene): THREE.DataTexture {
  if (!scene.metadata.n_things) return integers(new Uint16Array(WIDTH).fill(NO_OWNER), 1, THREE.UnsignedShortType, "R16UI");
  const data = byGaussian(scene, "owners", new Uint16Array(texels(scene)));
  return integers(data, data.length / WIDTH, THREE.UnsignedShortType, "R16UI");
}

/** Of a texture with a number for each Gaussian and level. */
function texels({ count, levels }: Scene): number {
  return WIDTH * Math.max(1, Math.ceil((count * levels) / WIDTH));
}

/** Fill in a tensor: all levels of a Gaussian beside each other. */
function byGaussian<Numbers extends Uint8Array | Uint16Array>(scene: Scene, name: string, out: Numbers): Numbers {
  const { count, levels } = scene;
  const { data } = scene.tensor(name);
  for (let level = 0; level < levels; level++) {
    for (let i = 0; i < count; i++) out[i * levels + level] = data[level * count + i];
  }
  return out;
}

function confidenceTexture(scene: Scene): THREE.DataTexture {
  const data = byGaussian(scene, "confidence", new Uint8Array(texels(scene)));
  const texture = new THREE.DataTexture(data, WIDTH, data.length / WIDTH, THREE.RedFormat, THREE.UnsignedByteType);
  texture.needsUpdate = true;
  return texture;
}

/** A colour for each atom, and the offset of its level in the last column. */
function codeColorTexture(scene: Scene): THREE.DataTexture {
  const { levels, atoms } = scene;
  const texture = floats(atoms + 1, levels);
  const offsets = scene.tensor("code_color_offsets").data;
  for (let line = 0; line < levels * 3; line++) {
    const colors = scene.tensor("code_colors").data.subarray(line * atoms, (line + 1) * atoms);
    write(texture, Math.floor(line / 3), line % 3, [...colors, offsets[line]]);
  }
  return texture;
}
