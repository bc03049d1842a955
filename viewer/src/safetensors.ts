// Gzipped safetensors files: tensors by name, and JSON under the key "scoup".
import { DataUtils } from "three";

export type TensorData = Uint8Array | Int8Array | Uint16Array | Float32Array | Float64Array | Int32Array;

export interface Tensor {
  data: TensorData;
  shape: number[];
}

export interface Packed {
  tensors: Map<string, Tensor>;
  metadata: unknown;
}

export type Progress = (stage: string, done: number, total: number) => void;

interface Entry {
  dtype: string;
  shape: number[];
  data_offsets: [number, number];
}

/** What a gzipped file holds. */
export async function unpack(bytes: Uint8Array<ArrayBuffer>): Promise<Packed> {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const buffer = await new Response(stream).arrayBuffer();
  const length = Number(new DataView(buffer).getBigUint64(0, true));
  const text = new TextDecoder().decode(new Uint8Array(buffer, 8, length));
  const { __metadata__: metadata, ...header } = JSON.parse(text) as { __metadata__: { scoup: string } };
  const tensors = new Map<string, Tensor>();
  for (const [name, entry] of Object.entries(header as Record<string, Entry>)) {
    const [start, end] = entry.data_offsets;
    // A copy: tensors need not begin at a multiple of the size of their numbers.
    tensors.set(name, { data: numbers(entry.dtype, buffer.slice(8 + length + start, 8 + length + end)), shape: entry.shape });
  }
  return { tensors, metadata: JSON.parse(metadata.scoup) };
}

const KINDS = { U8: Uint8Array, I8: Int8Array, U16: Uint16Array, F32: Float32Array, F64: Float64Array, I32: Int32Array };

function numbers(dtype: string, buffer: ArrayBuffer): TensorData {
  if (dtype === "F16") return Float32Array.from(new Uint16Array(buffer), (bits) => DataUtils.fromHalfFloat(bits));
  if (dtype in KINDS) return new KINDS[dtype as keyof typeof KINDS](buffer);
  throw new Error(`numbers of type ${dtype} are not known`);
}

/** Bytes of base64 text. */
export function fromBase64(text: string): Uint8Array<ArrayBuffer> {
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  return bytes;
}

/** The body of a response, with progress while it comes. */
export async function download(response: Response, progress: Progress): Promise<Uint8Array<ArrayBuffer>> {
  const total = Number(response.headers.get("content-length") ?? 0);
  if (!response.body || !total) return new Uint8Array(await response.arrayBuffer());
  const bytes = new Uint8Array(total);
  const reader = response.body.getReader();
  let done = 0;
  for (;;) {
    const part = await reader.read();
    if (part.done) break;
    bytes.set(part.value, done);
    done += part.value.length;
    progress("loading", done, total);
  }
  if (done !== total) throw new Error("the scene was cut short; reload the page");
  return bytes;
}
