// The method's own picture of the current camera, rendered by the server, over the page's.
import type { Server } from "./answers";
import type { Eye } from "./camera";
import { NotNow } from "./server";
import type { State } from "./state";

const REST_SECONDS = 0.4;
const QUALITY = 92;

export class ExactPicture {
  /** Whether to show it by itself when the camera rests. */
  whenResting = false;
  /** Shown, or on its way. */
  private wanted = false;
  private number = 0;
  private timer = 0;

  constructor(
    private readonly image: HTMLImageElement,
    private readonly badge: HTMLElement,
    private readonly eye: Eye,
    private readonly state: State,
    private readonly server: Server,
    private readonly onError: (sentence: string) => void,
  ) {}

  get isShown(): boolean {
    return this.wanted;
  }

  /** The camera has moved: the picture is of another view now. */
  moved(): void {
    this.hide();
    clearTimeout(this.timer);
    if (this.whenResting) this.timer = window.setTimeout(() => this.show(), REST_SECONDS * 1000);
  }

  /** Texts or settings have changed. */
  changed(): void {
    if (this.wanted || this.whenResting) void this.show();
  }

  hide(): void {
    this.number += 1;
    this.wanted = false;
    this.image.hidden = this.badge.hidden = true;
  }

  async show(): Promise<void> {
    const number = ++this.number;
    this.wanted = true;
    const { clientWidth: width, clientHeight: height } = this.image.parentElement!;
    this.badge.textContent = "rendering the exact picture …";
    this.badge.hidden = false;
    try {
      const request = this.state.picture(this.eye.record(width, height), QUALITY);
      const blob = await this.server.picture(request);
      if (number !== this.number) return;
      URL.revokeObjectURL(this.image.src);
      this.image.src = URL.createObjectURL(blob);
      await this.image.decode();
      if (number !== this.number) return;
      const what = request.text === null ? "" : ` of “${request.text}”`;
      this.badge.textContent = `exact picture${what} (rendered codes, all Gaussians)`;
      this.image.hidden = false;
    } catch (error) {
      if (number !== this.number) return;
      this.hide();
      if (!(error instanceof NotNow)) this.onError((error as Error).message);
    }
  }
}
