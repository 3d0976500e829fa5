// Linear algebra of a few rows: all that the page computes by itself.
// Matrices are functions (row, column) => number, or flat arrays by rows.

/** Lower Cholesky factor, by rows, of a symmetric positive definite matrix of n rows. */
export function cholesky(matrix, n) {
  const L = new Float64Array(n * n);
  for (let i = 0; i < n; i++) {
    for (let j = 0; j <= i; j++) {
      let sum = matrix(i, j);
      for (let k = 0; k < j; k++) sum -= L[i * n + k] * L[j * n + k];
      if (i === j) {
        if (!(sum > 0)) throw new RangeError("the matrix is not positive definite");
        L[i * n + i] = Math.sqrt(sum);
      } else {
        L[i * n + j] = sum / L[j * n + j];
      }
    }
  }
  return L;
}

/** x with L x = b. */
export function forward(L, b) {
  const n = b.length;
  const x = Float64Array.from(b);
  for (let i = 0; i < n; i++) {
    for (let k = 0; k < i; k++) x[i] -= L[i * n + k] * x[k];
    x[i] /= L[i * n + i];
  }
  return x;
}

/** x with L' x = b. */
export function backward(L, b) {
  const n = b.length;
  const x = Float64Array.from(b);
  for (let i = n - 1; i >= 0; i--) {
    for (let k = i + 1; k < n; k++) x[i] -= L[k * n + i] * x[k];
    x[i] /= L[i * n + i];
  }
  return x;
}

/** Diagonal of (L L')^-1. */
export function inverseDiagonal(L, n) {
  const found = new Float64Array(n);
  for (let j = 0; j < n; j++) {
    const unit = new Float64Array(n);
    unit[j] = 1;
    const x = forward(L, unit);
    for (const value of x) found[j] += value * value;
  }
  return found;
}

/**
 * By how much some columns raise the log evidence, with unit normal priors: `gain`, their posterior
 * `mean` and `spread` (standard deviations). `gram(a, b)` of the readings (0) and of columns
 * (from 1); `columns` from 0. Python: residyn.diagnosis.evidence.subset.
 */
export function subset(gram, columns) {
  const n = columns.length;
  const L = cholesky((i, j) => gram(columns[i] + 1, columns[j] + 1) + (i === j ? 1 : 0), n);
  const x = forward(
    L,
    columns.map((c) => -gram(c + 1, 0)),
  );
  let gain = 0;
  for (let i = 0; i < n; i++) gain += 0.5 * x[i] * x[i] - Math.log(L[i * n + i]);
  return { gain, mean: backward(L, x), spread: inverseDiagonal(L, n).map(Math.sqrt) };
}

/** v' G v, where v is 1 for row 0, `values` for `columns` (from 0), else 0. */
export function quadratic(gram, columns, values) {
  const rows = [0, ...columns.map((c) => c + 1)];
  const v = [1, ...values];
  let sum = 0;
  for (let i = 0; i < rows.length; i++) {
    for (let j = 0; j < rows.length; j++) sum += v[i] * v[j] * gram(rows[i], rows[j]);
  }
  return sum;
}

/** log sum exp. */
export function logSumExp(values) {
  const top = Math.max(...values);
  if (!Number.isFinite(top)) return top;
  return top + Math.log(values.reduce((sum, x) => sum + Math.exp(x - top), 0));
}

/** log of the normal distribution function. */
export function logNormal(x) {
  if (x > -2) return Math.log(0.5 * complement(-x / Math.SQRT2));
  // The continued fraction of Mills' ratio, from far out.
  let fraction = 0;
  const z = -x;
  for (let k = 200; k >= 1; k--) fraction = k / (z + fraction);
  return -0.5 * z * z - 0.5 * Math.log(2 * Math.PI) - Math.log(z + fraction);
}

/** erfc for arguments up to 2: 1 less the Taylor series of erf, or 2 less the fraction. */
function complement(x) {
  if (x < -2) return 2 - Math.exp(logNormal(x * Math.SQRT2) + Math.LN2);
  let term = x;
  let sum = x;
  for (let k = 1; k < 80; k++) {
    term *= (-x * x) / k;
    sum += term / (2 * k + 1);
  }
  return 1 - (2 / Math.sqrt(Math.PI)) * sum;
}

/** log of the gamma function of a positive whole number. */
export function logFactorial(n) {
  let sum = 0;
  for (let k = 2; k <= n; k++) sum += Math.log(k);
  return sum;
}
