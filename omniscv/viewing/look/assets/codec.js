// Packed arrays (arrays.py) back into typed arrays.

const WORDS = {
  f4: [Uint32Array, Float32Array], u4: [Uint32Array, Uint32Array], u2: [Uint16Array, Uint16Array],
  i2: [Uint16Array, Int16Array], i1: [Uint8Array, Int8Array], u1: [Uint8Array, Uint8Array],
};

function bytesOf(base64) {
  const text = atob(base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// {width, height, channels, data}: the channels of a pixel are together in data.
async function unpack(packed) {
  const [channels, height, width] = packed.shape, count = channels * height * width;
  const [Words, Values] = WORDS[packed.type], size = Words.BYTES_PER_ELEMENT;
  const bytes = await inflated(bytesOf(packed.data)), words = new Words(count);
  for (let c = 0, from = 0; c < channels; c++) {
    for (let y = 0; y < height; y++) {
      let word = 0;
      for (let x = 0, to = y * width * channels + c; x < width; x++, from++, to += channels) {
        let step = bytes[from];
        if (size > 1) step |= bytes[count + from] << 8;
        if (size > 2) step |= (bytes[2 * count + from] << 16) | (bytes[3 * count + from] << 24);
        word = (word + step) | 0;
        words[to] = word;
      }
    }
  }
  return { width, height, channels, data: new Values(words.buffer) };
}

// A picture as a bitmap with the values of its file: no colour management.
function bitmapOf(layer) {
  const blob = new Blob([bytesOf(layer.data)], { type: layer.type });
  return createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
}
