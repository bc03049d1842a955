// A page without a server: scene and vocabulary lie within it.
import type { Answer, Source } from "./answers";
import type { Words } from "./picking";
import { fromBase64, unpack, type Packed, type Progress } from "./safetensors";
import type { Metadata, Thing } from "./scene_data";
import { Vocabulary, type WordsMetadata } from "./vocabulary";

interface PageData {
  /** Of the export, if it has several files. */
  mark?: string;
  scene: string;
  words: string;
  thumbnails: (string | null)[];
  /** Of a large scene; of a page in several files, those that are loaded. */
  parts: string[];
}

declare global {
  interface Window {
    scoupData?: PageData;
  }
}

export class ExportedPage implements Source {
  private readonly data: PageData;
  private packed: Promise<Packed> | null = null;
  private packedWords: Promise<Packed> | null = null;
  private words: Vocabulary | null = null;

  constructor() {
    this.data = window.scoupData ?? ({} as PageData);
    for (const name of ["scene", "words", "thumbnails"] as const) {
      if (this.data[name] === undefined) throw this.unusable(name);
    }
  }

  scene(progress: Progress): Promise<Packed> {
    progress("opening", 0, 0);
    this.packed ??= this.unpacked("scene", this.data.scene);
    return this.packed;
  }

  async part(number: number): Promise<Packed> {
    const { parts, mark } = this.data;
    if (!parts[number]) await loaded(`part_${number}.js?${mark}`);
    const text = parts[number];
    parts[number] = "";
    return this.unpacked(`part_${number}`, text);
  }

  async metadata(): Promise<Metadata> {
    return (await this.scene(() => {})).metadata as Metadata;
  }

  async vocabulary(): Promise<{ names: string[]; closed: boolean }> {
    return { names: await this.names(), closed: true };
  }

  async things(): Promise<Thing[]> {
    return (await this.metadata()).things!;
  }

  thumbnail(camera: number): string | null {
    const picture = this.data.thumbnails[camera];
    return picture ? `data:image/jpeg;base64,${picture}` : null;
  }

  async ask(texts: string[]): Promise<Answer[]> {
    if (!this.data.words) throw new Error("this page was exported without words");
    this.words ??= new Vocabulary(await this.unpackedWords(), await this.things());
    return texts.map((text) => this.words!.answer(text));
  }

  private async names(): Promise<string[]> {
    return this.data.words ? ((await this.unpackedWords()).metadata as WordsMetadata).names : [];
  }

  /** What a click compares with. */
  async clickWords(): Promise<Words> {
    const names = await this.names();
    if (!names.length) return { names, scores: new Float32Array(), gram: new Float32Array() };
    const { tensors } = await this.unpackedWords();
    const [scores, gram] = ["scores", "gram"].map((name) => tensors.get(name)!.data as Float32Array);
    return { names, scores, gram };
  }

  private unpackedWords(): Promise<Packed> {
    this.packedWords ??= this.unpacked("words", this.data.words);
    return this.packedWords;
  }

  private async unpacked(name: string, text: string): Promise<Packed> {
    try {
      return await unpack(fromBase64(text));
    } catch {
      throw this.unusable(name);
    }
  }

  private unusable(name: string): Error {
    const problem = this.data.mark ? `${name}.js is missing, damaged or of another export` : "this page is damaged";
    return new Error(`${problem}; reload the page, or export it again`);
  }
}

/** Run a script beside the page, if it is there. */
function loaded(name: string): Promise<void> {
  return new Promise((resolve) => {
    const script = document.createElement("script");
    script.src = name;
    script.onload = script.onerror = () => resolve();
    document.head.append(script);
  });
}
