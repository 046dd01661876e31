// Nearest neighbours among descriptors of unit length, as elf_runtime.match has them: by Euclidean distance.

function product(a, i, b, j, dim) {
  let sum = 0;
  for (let k = 0, p = i * dim, q = j * dim; k < dim; k++) sum += a[p + k] * b[q + k];
  return sum;
}

// Pairs of indices that are each other's nearest, ties to the lower index; with a ratio below 1 only those that are
// nearer to the first side's than that times the second nearest.  Descriptors are rows of `dim` values.
export function mutualMatches(first, second, dim, ratio = 1) {
  if (!dim) return [];
  const n = first.length / dim, m = second.length / dim;
  const back = new Int32Array(m).fill(-1), backBest = new Float64Array(m).fill(-Infinity);
  const nearest = new Int32Array(n).fill(-1), passes = new Uint8Array(n);
  for (let i = 0; i < n; i++) {
    let best = -Infinity, next = -Infinity;
    for (let j = 0; j < m; j++) {
      const alike = product(first, i, second, j, dim);
      if (alike > best) [next, best, nearest[i]] = [best, alike, j];
      else if (alike > next) next = alike;
      if (alike > backBest[j]) [backBest[j], back[j]] = [alike, i];
    }
    // |a - b|^2 = 2 - 2 a.b
    passes[i] = ratio >= 1 || 2 - 2 * best < ratio * ratio * (2 - 2 * next) ? 1 : 0;
  }
  const pairs = [];
  for (let i = 0; i < n; i++) if (nearest[i] >= 0 && back[nearest[i]] === i && passes[i]) pairs.push([i, nearest[i]]);
  return pairs;
}
