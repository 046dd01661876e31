// Pictures from files, addresses and the camera, and their pixels at a working size.

// A picture as it is stored: no colours converted, and upright as its EXIF data have it.
export async function pictureOf(blob, name) {
  try {
    return await createImageBitmap(blob, { colorSpaceConversion: "none" });
  } catch {
    throw new Error(`${name} is no picture that this browser can read`);
  }
}

// Width and height with the longer side at most `longest`.
export function workingSize({ width, height }, longest) {
  const scale = Math.min(1, longest / Math.max(width, height));
  return { width: Math.max(1, Math.round(width * scale)), height: Math.max(1, Math.round(height * scale)) };
}

// {data, width, height}, RGBA, of a bitmap at most `longest` wide and high.
export function pixelsOf(bitmap, longest) {
  const { width, height } = workingSize(bitmap, longest);
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d", { alpha: false, willReadFrequently: true });
  context.imageSmoothingQuality = "high";
  context.drawImage(bitmap, 0, 0, width, height);
  return { data: context.getImageData(0, 0, width, height).data, width, height };
}

export class Camera {
  // Ask for the camera and start it.
  static async open() {
    if (!navigator.mediaDevices) throw new Error("no camera here: browsers give it to https pages and to localhost only");
    const wanted = { video: { width: { ideal: 1280 }, facingMode: "environment" } };
    const stream = await navigator.mediaDevices.getUserMedia(wanted).catch((error) => {
      const why = { NotAllowedError: "its use was not allowed", NotFoundError: "there is none" }[error.name];
      throw new Error(`no camera: ${why || error.message}`);
    });
    const video = Object.assign(document.createElement("video"), { srcObject: stream, muted: true, playsInline: true });
    await video.play();
    return Object.assign(new Camera(), { stream, video });
  }

  // The frame that is there now.
  frame(longest) {
    const { width, height } = workingSize({ width: this.video.videoWidth, height: this.video.videoHeight }, longest);
    return createImageBitmap(this.video, { resizeWidth: width, resizeHeight: height });
  }

  stop() {
    for (const track of this.stream.getTracks()) track.stop();
  }
}
