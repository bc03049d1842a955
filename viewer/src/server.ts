// The server of a live page.
import type { Answer, PictureRequest, Place, Selection, Source } from "./answers";
import { pause } from "./pause";
import { download, fromBase64, unpack, type Packed, type Progress } from "./safetensors";
import type { CameraRecord, Metadata, Thing } from "./scene_data";

const POLL_SECONDS = 3;
const UNREACHABLE = "The server does not answer.";
const ANOTHER = "Another field is served here now; reload the page.";

/** A picture that is no longer wanted, or a server that is busy: ask again. */
class NotNow extends Error {}

/** What is asked for, once the server has time for it or answers again. */
export async function patiently<Answered>(ask: () => Promise<Answered>, seconds: number): Promise<Answered> {
  for (;;) {
    try {
      return await ask();
    } catch (error) {
      if (!(error instanceof NotNow)) throw error;
      await pause(seconds);
    }
  }
}

export class LiveServer implements Source {
  private readonly visitor = crypto.getRandomValues(new Uint32Array(2)).join("-");

  async vocabulary(): Promise<{ names: string[]; closed: boolean }> {
    return (await this.get("api/vocabulary")).json();
  }

  async metadata(): Promise<Metadata> {
    return (await this.get("api/scene")).json();
  }

  async scene(progress: Progress): Promise<Packed> {
    return unpack(await download(await this.get("scene.bin"), progress));
  }

  async part(number: number, count: number, whole = false): Promise<Packed> {
    let bytes: Uint8Array<ArrayBuffer>;
    try {
      const response = await fetch(`part/${number}-of-${count}${whole ? "?whole" : ""}`);
      // After a restart, another field may answer.
      if (response.ok && response.headers.get("x-scoup-field") !== this.identity) throw new Error(ANOTHER);
      bytes = await download(await checked(response), () => {});
    } catch (error) {
      // fetch and streams throw this where the connection ends.
      throw error instanceof TypeError ? new NotNow(UNREACHABLE) : error;
    }
    return unpack(bytes);
  }

  async things(): Promise<Thing[]> {
    return (await (await this.get("api/things")).json()).things;
  }

  thumbnail(camera: number): string {
    return `api/thumbnail/${camera}`;
  }

  async ask(texts: string[]): Promise<Answer[]> {
    const { answers } = await (await this.post("query", { texts })).json();
    return answers.map((record: Record<string, unknown>) => ({
      ...record,
      scores: new Float32Array(fromBase64(record.scores as string).buffer),
    }));
  }

  async picture(request: PictureRequest): Promise<Blob> {
    return (await this.post("render", request)).blob();
  }

  async point(camera: CameraRecord, pixel: [number, number]): Promise<Place> {
    return (await this.post("point", { camera, pixel })).json();
  }

  async select(selection: Selection): Promise<{ blob: Blob; name: string }> {
    const response = await this.post("select", selection);
    const name = /filename="([^"]+)"/.exec(response.headers.get("content-disposition") ?? "")?.[1];
    return { blob: await response.blob(), name: name ?? "selection.ply" };
  }

  constructor(private readonly identity: string) {}

  /** Call back when the server stops answering, when it answers again, and when it is another one. */
  watch(onChange: (state: "alive" | "closed" | "other") => void): void {
    let missed = 0;
    const poll = async () => {
      try {
        const response = await fetch("api/alive", { cache: "no-store" });
        // Another field, or another token: what the page holds does not fit its answers.
        if (!response.ok || response.headers.get("x-scoup-field") !== this.identity) return onChange("other");
        if (missed > 1) onChange("alive");
        missed = 0;
      } catch {
        missed += 1;
        if (missed === 2) onChange("closed");
      }
      setTimeout(poll, POLL_SECONDS * 1000 * (missed === 1 ? 0.2 : 1));
    };
    setTimeout(poll, POLL_SECONDS * 1000);
  }

  private async get(path: string): Promise<Response> {
    return checked(await reached(fetch(path)));
  }

  private async post(path: string, message: object): Promise<Response> {
    const headers = { "content-type": "application/json", "x-scoup-visitor": this.visitor };
    return checked(await reached(fetch(`api/${path}`, { method: "POST", headers, body: JSON.stringify(message) })));
  }
}

async function reached(request: Promise<Response>): Promise<Response> {
  try {
    return await request;
  } catch {
    throw new Error(UNREACHABLE);
  }
}

async function checked(response: Response): Promise<Response> {
  if (response.ok) return response;
  let reason = `the server answered ${response.status}`;
  try {
    reason = (await response.json()).error ?? reason;
  } catch {
    // Not of our server: the number has to do.
  }
  throw response.status === 409 || response.status === 503 ? new NotNow(reason) : new Error(reason);
}
