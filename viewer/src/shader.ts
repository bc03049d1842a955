// What happens to each Gaussian on the GPU: cosines from its codes, relevancy, and a colour.
import { NO_OWNER } from "./scene_data";

/** Queries shown at once. */
export const MOST_QUERIES = 8;
/** Width of textures that hold something for each Gaussian. */
export const WIDTH = 4096;

/** Of what is cleaned up: opacity of haze below, and longest by middle axis of needles above. */
const [HAZE, NEEDLE] = ["0.1", "10.0"];

/** In the place of a threshold: things answer, not relevancy. */
export const BY_THINGS = -1;

export const MODES = ["colour", "heat", "only", "except", "codes", "confidence", "relevancy"] as const;
export type Mode = (typeof MODES)[number];

// From dark violet over red and orange to light yellow, as in scoup.pictures.colors.
export const HEAT: readonly (readonly [number, number, number])[] = [
  [0, 0, 4], [31, 12, 72], [85, 15, 109], [136, 34, 106], [186, 54, 85], [227, 89, 51], [249, 140, 10], [249, 201, 50],
  [252, 255, 164],
];

/** Red, green and blue, 0..1. */
export type Color = readonly [number, number, number];

/** Colour of what is selected by a click. */
export const SELECTED: Color = [0.25, 0.66, 1];
/** Bits of a thing in its texture, above those of the queries that select it. */
export const MARKS = { selected: 1 << 8, hidden: 1 << 9 } as const;

export interface Sizes {
  levels: number;
  k: number;
  phrases: number;
  /** Of all levels. */
  things: number;
}

/** Declarations for the shader of a scene; loops have fixed lengths. */
export function functions({ levels, k, phrases }: Sizes): string {
  const blocks = Math.ceil(k / 4);
  const stops = HEAT.map((color) => `vec3(${color.map((part) => (part / 255).toFixed(6)).join(",")})`);
  return `
const vec3 SCOUP_HEAT[${HEAT.length}] = vec3[${HEAT.length}](${stops.join(",")});

ivec2 scoupPlace(int index) { return ivec2(index % ${WIDTH}, index / ${WIDTH}); }

vec3 scoupHeat(float amount) {
  float place = clamp(amount, 0.0, 1.0) * ${(HEAT.length - 1).toFixed(1)};
  int low = min(int(place), ${HEAT.length - 2});
  return mix(SCOUP_HEAT[low], SCOUP_HEAT[low + 1], place - float(low));
}

// Sum over the atoms of a code of weight times a row of a table: four columns at once.
vec4 scoupSum(usampler2D indices, usampler2D weights, float scale, sampler2D table, int code, int row) {
  vec4 sum = vec4(0.0);
  for (int block = 0; block < ${blocks}; block++) {
    ivec2 place = scoupPlace(code * ${blocks} + block);
    uvec4 atoms = texelFetch(indices, place, 0);
    vec4 shares = vec4(texelFetch(weights, place, 0)) * scale;
    for (int part = 0; part < 4; part++) sum += shares[part] * texelFetch(table, ivec2(int(atoms[part]), row), 0);
  }
  return sum;
}

bool scoupCoded(usampler2D weights, int code) {
  uvec4 sum = uvec4(0u);
  for (int block = 0; block < ${blocks}; block++) sum |= texelFetch(weights, scoupPlace(code * ${blocks} + block), 0);
  return any(notEqual(sum, uvec4(0u)));
}

// Bits of all things that a Gaussian belongs to, level by level.
uint scoupMarks(usampler2D owners, usampler2D things, int index) {
  uint marks = 0u;
  for (int level = 0; level < ${levels}; level++) {
    uint owner = texelFetch(owners, scoupPlace(index * ${levels} + level), 0).r;
    if (owner != ${NO_OWNER}u) marks |= texelFetch(things, scoupPlace(int(owner)), 0).r;
  }
  return marks;
}

// Relevancy of a query: method.md, stage 3. The largest cosine of the canonical phrases is the same for all queries.
float scoupRelevancy(usampler2D indices, usampler2D weights, float scale, sampler2D canonical, sampler2D scores, int code, int level, int query) {
  float best = -1e9;
  for (int group = 0; group < ${Math.max(1, Math.ceil(phrases / 4))}; group++) {
    vec4 sums = scoupSum(indices, weights, scale, canonical, code, level * ${Math.max(1, Math.ceil(phrases / 4))} + group);
    for (int part = 0; part < 4; part++) if (group * 4 + part < ${phrases}) best = max(best, sums[part]);
  }
  vec4 own = scoupSum(indices, weights, scale, scores, code, level * ${MOST_QUERIES / 4} + query / 4);
  return 1.0 / (1.0 + exp(-10.0 * (own[query % 4] - best)));
}
`;
}

/** Names of the inputs of `body`. */
export type Inputs = Record<
  | "gsplat" | "indices" | "weights" | "scale" | "canonical" | "scores" | "queries" | "owners" | "things" | "confidence"
  | "codeColors" | "mode" | "level" | "opacity" | "anySelected" | "clean",
  string
>;

/** The colour of one Gaussian; `out` is the Gaussian to be written. */
export function body(inputs: Inputs, out: string, { levels, things }: Sizes): string {
  const code = `(${inputs.gsplat}.index * ${levels} + level)`;
  return `
${out} = ${inputs.gsplat};
vec3 plain = ${out}.rgba.rgb;
float grey = 0.62 * dot(plain, vec3(0.299, 0.587, 0.114));
vec3 tint = vec3(0.0);
float strongest = -1.0, amount = 0.0, relevancy = 0.5;
bool asked = false, selected = false;
uint marks = ${things ? `scoupMarks(${inputs.owners}, ${inputs.things}, ${inputs.gsplat}.index)` : "0u"};
for (int query = 0; query < ${MOST_QUERIES}; query++) {
  vec4 look = texelFetch(${inputs.queries}, ivec2(query, 0), 0);
  int level = int(look.a);
  if (level < 0) continue;
  asked = true;
  vec4 cut = texelFetch(${inputs.queries}, ivec2(query, 1), 0);
  // Things may own Gaussians that have no code; their relevancy counts as the least.
  bool coded = scoupCoded(${inputs.weights}, ${code}), byThings = cut.z < 0.0;
  if (!coded && !byThings) continue;
  float found = !coded ? 0.5 : scoupRelevancy(${inputs.indices}, ${inputs.weights}, ${inputs.scale}, ${inputs.canonical}, ${inputs.scores}, ${code}, level, query);
  float rescaled = coded && cut.y - cut.x > 1e-6 ? clamp((found - cut.x) / (cut.y - cut.x), 0.0, 1.0) : 0.0;
  bool above = byThings ? (marks >> uint(query) & 0x10001u) == 1u : rescaled > cut.z;
  if (above && rescaled > strongest || !selected && rescaled > amount) tint = look.rgb;
  if (above) { selected = true; strongest = max(strongest, rescaled); }
  amount = max(amount, rescaled);
  if (query == 0) relevancy = found;
}
bool clicked = (marks & ${MARKS.selected}u) != 0u;
int several = int(texelFetch(${inputs.queries}, ivec2(0, 1), 0).w);
int level = ${inputs.level};
if (${inputs.mode} == 0) {
  if (asked) ${out}.rgba.rgb = selected ? mix(plain, tint, 0.5 * ${inputs.opacity}) : plain * (1.0 - 0.35 * ${inputs.opacity});
} else if (${inputs.mode} == 1) {
  if (asked) {
    float share = clamp((amount - 0.08) / 0.5, 0.0, 1.0);
    share = 0.92 * share * share * (3.0 - 2.0 * share);
    // One colour a text has no dark end to fade into: what is not selected stays faint.
    if (several > 1) share = selected ? 0.85 + 0.15 * amount : 0.5 * amount * amount;
    ${out}.rgba.rgb = mix(vec3(grey), several > 1 ? tint : scoupHeat(amount), share * ${inputs.opacity});
  }
} else if (${inputs.mode} == 2) {
  // What clicks select goes before what texts select.
  if (${inputs.anySelected} != 0 ? !clicked : asked && !selected) ${out}.rgba.a = 0.0;
  vec3 sizes = ${out}.scales;
  float longest = max(sizes.x, max(sizes.y, sizes.z));
  float middle = max(min(sizes.x, sizes.y), min(max(sizes.x, sizes.y), sizes.z));
  if (${inputs.clean} != 0 && (${out}.rgba.a < ${HAZE} || longest > ${NEEDLE} * middle)) ${out}.rgba.a = 0.0;
} else if (${inputs.mode} == 3) {
  if (${inputs.anySelected} != 0 ? clicked : selected) ${out}.rgba.a = 0.0;
} else if (${inputs.mode} == 4) {
  vec3 shown = vec3(0.0);
  if (scoupCoded(${inputs.weights}, ${code})) {
    vec4 offset = texelFetch(${inputs.codeColors}, ivec2(textureSize(${inputs.codeColors}, 0).x - 1, level), 0);
    vec4 sum = scoupSum(${inputs.indices}, ${inputs.weights}, ${inputs.scale}, ${inputs.codeColors}, ${code}, level);
    shown = 0.08 + 0.9 * clamp(sum.rgb + offset.rgb, 0.0, 1.0);
  }
  ${out}.rgba.rgb = mix(plain, shown, ${inputs.opacity});
} else if (${inputs.mode} == 5) {
  float confidence = texelFetch(${inputs.confidence}, scoupPlace(${code}), 0).r;
  ${out}.rgba.rgb = mix(vec3(grey), scoupHeat(confidence * confidence), ${inputs.opacity});
} else {
  ${out}.rgba.rgb = vec3(relevancy);
}
if (clicked && ${inputs.mode} != 2) ${out}.rgba.rgb = mix(${out}.rgba.rgb, vec3(${SELECTED.join(",")}), 0.25);
if ((marks & ${MARKS.hidden}u) != 0u) ${out}.rgba.a = 0.0;`;
}
