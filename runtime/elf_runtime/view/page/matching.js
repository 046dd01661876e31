// Nearest neighbours among descriptors of 8 bits, as elf_runtime.match has them: by Euclidean distance.

function squaredDistance(a, i, b, j) {
  let sum = 0;
  for (let k = 0, p = i * a.dim, q = j * b.dim; k < a.dim; k++) {
    const difference = a.descriptors[p + k] - b.descriptors[q + k];
    sum += difference * difference;
  }
  return sum;
}

// The index among `others` of the nearest to a keypoint, or -1; only keypoints with a descriptor have one.
function nearest(image, keypoint, other, others) {
  const a = image.candidates, b = other.candidates;
  if (keypoint.candidate < 0 || a.dim === 0 || a.dim !== b.dim) return -1;
  let best = -1, least = Infinity;
  others.forEach((candidate, index) => {
    if (candidate.candidate < 0) return;
    const distance = squaredDistance(a, keypoint.candidate, b, candidate.candidate);
    if (distance < least) [best, least] = [index, distance];
  });
  return best;
}

// Pairs of indices that are each other's nearest.
function mutualMatches(image, keypoints, other, others) {
  const back = others.map((keypoint) => nearest(other, keypoint, image, keypoints));
  const pairs = [];
  keypoints.forEach((keypoint, i) => {
    const j = nearest(image, keypoint, other, others);
    if (j >= 0 && back[j] === i) pairs.push([i, j]);
  });
  return pairs;
}

// The cosine of two descriptors, whose bytes are 128 + 192 x.
function similarity(a, i, b, j) {
  let product = 0, first = 0, second = 0;
  for (let k = 0; k < a.dim; k++) {
    const u = a.descriptors[i * a.dim + k] - 128, v = b.descriptors[j * b.dim + k] - 128;
    product += u * v;
    first += u * u;
    second += v * v;
  }
  return product / Math.sqrt(first * second || 1);
}
