// The camera: orbiting, flying to a camera of the field, and what the server is told of it.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import type { CameraRecord, Metadata } from "./scene_data";

const FLIGHT_SECONDS = 0.8;
/** Share of the distance that a key moves. */
const STEP = 0.06;

/** A camera that the visitor moves. Cameras of fields have OpenCV axes, three.js has OpenGL's. */
export class Eye {
  readonly camera = new THREE.PerspectiveCamera(50, 1, 0.01, 1000);
  readonly controls: OrbitControls;
  /** The camera of the field that is looked through; null once the visitor has moved. */
  at: CameraRecord | null = null;
  onMove: () => void = () => {};
  private readonly radius: number;
  private flight = 0;
  private dragged = false;

  constructor(metadata: Metadata, element: HTMLElement) {
    this.radius = metadata.radius;
    const centre = new THREE.Vector3(...metadata.centre);
    this.camera.near = metadata.radius / 500;
    this.camera.far = metadata.radius * 500;
    this.camera.up.set(...metadata.up);
    const aside = new THREE.Vector3(1, 0, 0).cross(this.camera.up);
    if (aside.length() < 0.1) aside.set(0, 1, 0).cross(this.camera.up);
    this.camera.position.copy(centre).addScaledVector(aside.normalize(), metadata.radius * 1.5);
    this.controls = new OrbitControls(this.camera, element);
    this.controls.target.copy(centre);
    this.controls.enableDamping = false;
    this.controls.zoomToCursor = true;
    this.controls.update();
    this.controls.addEventListener("start", () => {
      this.flight += 1;
      this.dragged = true;
    });
    this.controls.addEventListener("end", () => {
      this.dragged = false;
    });
    this.controls.addEventListener("change", () => {
      if (this.dragged) this.at = null; // a click alone leaves the camera where it is
      this.onMove();
    });
  }

  /** The shape of the picture; the field of view stays that of the height. */
  resize(width: number, height: number): void {
    this.camera.aspect = width / Math.max(1, height);
    this.camera.updateProjectionMatrix();
  }

  /** Move to a camera of the field, in a flight unless the visitor wants no motion. */
  async flyTo(record: CameraRecord, centre: THREE.Vector3, flies: boolean): Promise<void> {
    this.land();
    const flight = this.flight;
    const { position, quaternion } = poseOf(record);
    const fov = 2 * THREE.MathUtils.radToDeg(Math.atan(record.height / 2 / record.K[4]));
    const ahead = new THREE.Vector3(0, 0, -1).applyQuaternion(quaternion);
    const depth = Math.max(centre.clone().sub(position).dot(ahead), this.radius / 10);
    const target = position.clone().addScaledVector(ahead, depth);
    const from = { position: this.camera.position.clone(), target: this.controls.target.clone(), fov: this.camera.fov };
    const start = performance.now();
    for (let share = flies ? 0 : 1; ; ) {
      const eased = share * share * (3 - 2 * share);
      this.camera.position.lerpVectors(from.position, position, eased);
      this.controls.target.lerpVectors(from.target, target, eased);
      this.camera.fov = from.fov + (fov - from.fov) * eased;
      this.camera.updateProjectionMatrix();
      this.controls.update();
      if (share >= 1) break;
      await new Promise(requestAnimationFrame);
      if (flight !== this.flight) return;
      share = Math.min(1, (performance.now() - start) / 1000 / FLIGHT_SECONDS);
    }
    // Exactly: orbiting keeps up as it is, and a camera of the field may be rolled.
    this.camera.quaternion.copy(quaternion);
    this.camera.updateMatrixWorld();
    this.at = record;
    this.onMove();
  }

  /** Move by keys: fractions of the distance to the target, right, up and ahead. */
  step(right: number, up: number, ahead: number): void {
    this.land();
    const distance = this.camera.position.distanceTo(this.controls.target) * STEP;
    const shift = new THREE.Vector3(right, up, 0).multiplyScalar(distance).applyQuaternion(this.camera.quaternion);
    const towards = this.controls.target.clone().sub(this.camera.position).multiplyScalar(ahead * STEP);
    this.camera.position.add(shift).add(towards);
    this.controls.target.add(shift);
    this.controls.update();
    this.onMove();
  }

  /** Turn around the target by keys, in radians. */
  turn(angle: number): void {
    this.land();
    const offset = this.camera.position.clone().sub(this.controls.target);
    offset.applyAxisAngle(this.camera.up, angle);
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.onMove();
  }

  /** Orbit around a point from now on. */
  lookAround(point: THREE.Vector3): void {
    const ahead = new THREE.Vector3();
    this.camera.getWorldDirection(ahead);
    const depth = point.clone().sub(this.camera.position).dot(ahead);
    if (depth > 0) this.controls.target.copy(this.camera.position).addScaledVector(ahead, depth);
  }

  /** As the server takes it, for a picture of a size. */
  record(width: number, height: number): CameraRecord {
    this.camera.updateMatrixWorld();
    const view = this.camera.matrixWorldInverse.clone();
    const flipped = new THREE.Matrix4().makeScale(1, -1, -1).multiply(view);
    const focal = height / 2 / Math.tan(THREE.MathUtils.degToRad(this.camera.fov) / 2);
    const K = [focal, 0, width / 2, 0, focal, height / 2, 0, 0, 1];
    return { name: this.at?.name ?? "", viewmat: flipped.transpose().toArray(), K, width, height };
  }

  private land(): void {
    this.flight += 1;
    this.at = null;
  }
}

/** Position and OpenGL rotation of a camera record. */
export function poseOf(record: CameraRecord): { position: THREE.Vector3; quaternion: THREE.Quaternion } {
  const view = new THREE.Matrix4().fromArray(record.viewmat).transpose();
  const pose = view.invert().multiply(new THREE.Matrix4().makeScale(1, -1, -1));
  return {
    position: new THREE.Vector3().setFromMatrixPosition(pose),
    quaternion: new THREE.Quaternion().setFromRotationMatrix(pose),
  };
}
