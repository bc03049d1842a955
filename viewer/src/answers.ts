// Where answers come from: the server, or the vocabulary within an exported page. Both give the same.
import type { Packed, Progress } from "./safetensors";
import type { CameraRecord, Metadata, Thing } from "./scene_data";

export interface Settings {
  mode: "live" | "remote" | "exported";
  name: string;
  version: string;
  /** The command that opens this page. */
  open: string;
  /** The field and the table of words as commands name them. */
  field: string;
  text: string | null;
  /** Of the field: the same for the same codes. */
  identity: string;
}

/** What a scene answers to a text; Python decides all of it (`scoup.view.scene_answers`). */
export interface Answer {
  text: string;
  /** How commands ask it, if otherwise: an exported page takes names of its vocabulary whole. */
  asked?: string;
  level: number;
  /** The share of everyday words that fit this scene less well, 0 to 1; null with too few of them. */
  score: number | null;
  /** The score in words. */
  certainty: string | null;
  present: boolean;
  /** The best thing elsewhere, if it fits nearly as well. */
  runner_up: { thing: number; score: number | null } | null;
  /** The stable threshold of each level. */
  thresholds: number[];
  /** Relevancies that rescaling takes to 0 and 1, level by level. */
  spans: [number, number][];
  gaussians: number;
  /** Things that answer if no level is chosen, or would if the text were in the scene; null in a field without things. */
  chosen_things: number[] | null;
  /** The same if a level is chosen, level by level. */
  things: (number[] | null)[];
  /** Things whose Gaussians do not answer, as in “mug and not handle”. */
  without: number[];
  /** Of a phrase: score, what was found, and the camera that left and right are seen from; null of a text alone. */
  remark: string | null;
  /** [S, L] inner products of atoms and text. */
  scores: Float32Array;
}

/** What the scene says is at a point. */
export interface Place {
  position: number[] | null;
  distance: number | null;
  /** Relevancy is null of the names of things. */
  levels: { level: string; confidence: number; words: { text: string; relevancy: number | null }[] }[];
}

/** Which Gaussians are meant: those of things, or of texts, at a level and threshold of one's own or each text's. */
export interface Selection {
  things: { number: number; name: string }[];
  texts: string[];
  level: number | null;
  threshold: number | null;
  rest: boolean;
  always: boolean;
}

/** A picture that the server is to render. */
export interface PictureRequest {
  camera: CameraRecord;
  mode: "color" | "heat" | "mask" | "codes";
  texts: string[];
  /** Of the texts, 0..255. */
  colors: [number, number, number][];
  opacity: number;
  level: number | null;
  threshold: number | null;
  always: boolean;
  quality: number;
}

export interface Source {
  /** Names that the text box completes; only these can be asked if `closed`. */
  vocabulary(): Promise<{ names: string[]; closed: boolean }>;
  /** @throws Error with a sentence for the visitor */
  ask(texts: string[]): Promise<Answer[]>;
  thumbnail(camera: number): string | null;
  /** What the page shows first: all Gaussians, or few of a large scene. */
  scene(progress: Progress): Promise<Packed>;
  /**
   * A part of a large scene; a server's with none of its Gaussians merged if it is wanted whole.
   *
   * @throws NotNow if it is to be asked for again later
   */
  part(number: number, count: number, whole?: boolean): Promise<Packed>;
  /** The things of the field, in the order of their numbers; none where it has none. */
  things(): Promise<Thing[]>;
  /** The facts of a scene without its Gaussians. */
  metadata(): Promise<Metadata>;
}
