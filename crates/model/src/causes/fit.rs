//! How well a hypothesis explains a change: a normal likelihood whose covariance is that of a factor analysis, by Woodbury's identity.

use super::{Causes, Cell, Change, MAX_NUMBERS, MAX_RANK};

/// Most directions of a hypothesis: those of two cells.
const MOST_DIRECTIONS: usize = 2 * MAX_RANK;

pub(super) type Vector = [f64; MAX_NUMBERS];

/// A change in whitened coordinates.
pub(super) struct Whitened {
    pub(super) count: usize,
    /// What a coordinate is multiplied by.
    pub(super) weights: Vector,
    /// The change.
    pub(super) change: Vector,
}

/// A hypothesis, fitted.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    pub(super) log_likelihood: f64,
    /// Squared distance over the number of coordinates.
    pub(super) distance: f64,
    /// Where along each direction the change lies, standard deviations: those of the first cell, then those of the second.
    pub(super) along: [f64; MOST_DIRECTIONS],
    /// Factor of the directions' precision, their number, and the variance of a coordinate that they leave.
    factor: Factor,
    rank: usize,
    scale: f64,
}

impl Fit {
    /// Size of each fitted cell's cause, and its variance. Apart from the fit, since of hundreds of hypotheses few have any weight.
    pub(super) fn sizes(&self, cells: &[&Cell]) -> [(f64, f64); 2] {
        let mut sizes = [(0.0, 0.0); 2];
        let mut from = 0;
        for (slot, cell) in sizes.iter_mut().zip(cells) {
            *slot = size(cell, from, &self.along, (&self.factor, self.rank, self.scale));
            from += cell.rank;
        }
        sizes
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    // Four sums side by side: additions wait for each other otherwise.
    let mut sums = [0.0; 4];
    let (chunks_a, chunks_b) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = chunks_a.remainder().iter().zip(chunks_b.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in chunks_a.zip(chunks_b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    sums.iter().sum::<f64>() + rest
}

impl Causes {
    /// The change in coordinates in which noise and ordinary variation together have variance 1.
    pub(super) fn whitened(&self, change: &Change<'_>) -> Whitened {
        let count = self.numbers();
        let (mut weights, mut whitened) = ([0.0; MAX_NUMBERS], [0.0; MAX_NUMBERS]);
        let noise = change.noise * change.noise + LEAST_VARIANCE;
        let rows = self.file.basis.chunks_exact(count.max(1)).zip(&self.file.ordinary);
        for ((weight, value), (row, ordinary)) in weights.iter_mut().zip(&mut whitened).zip(rows) {
            *weight = 1.0 / libm::sqrt(noise + ordinary);
            *value = *weight * dot(row, change.numbers.get(..count).unwrap_or_default());
        }
        Whitened { count, weights, change: whitened }
    }

    /// Squared distance over the number of coordinates between two readings of one machine, of which noise and ordinary variation give 1.
    pub fn distance(&self, difference: &Change<'_>) -> f64 {
        let whitened = self.whitened(difference);
        dot(&whitened.change, &whitened.change) / whitened.count.max(1) as f64
    }

    /// Standard deviation of the noise on the command with which the phases' means scatter like this from cycle to cycle: the median over phases.
    pub fn noise_of(&self, deviations: &[f64]) -> f64 {
        let n = self.numbers().max(1);
        let mut noise = [0.0; MAX_NUMBERS];
        let rows = self.file.inverse.chunks_exact(n);
        let count = deviations.len().min(n);
        for (slot, (deviation, row)) in noise.iter_mut().zip(deviations.iter().zip(rows)) {
            *slot = deviation / libm::sqrt(dot(row, row)).max(f64::MIN_POSITIVE);
        }
        noise[..count].sort_unstable_by(f64::total_cmp);
        noise.get(..count).and_then(|noise| noise.get(count / 2)).copied().unwrap_or(0.0)
    }

    /// The numbers of a cell from a place on, one a coordinate.
    fn numbers_at(&self, at: usize) -> &[f64] {
        self.numbers.get(at..at + self.numbers()).unwrap_or_default()
    }

    pub(super) fn mean_of(&self, cell: &Cell) -> &[f64] {
        self.numbers_at(cell.at)
    }

    pub(super) fn direction_of(&self, cell: &Cell, which: usize) -> &[f64] {
        self.numbers_at(cell.at + (1 + which) * self.numbers())
    }

    /// Fits the sum of some cells, none, one or two.
    pub(super) fn fit(&self, whitened: &Whitened, cells: &[&Cell]) -> Fit {
        self.fit_beside(whitened, cells, None)
    }

    /// The same in what is left of all coordinates beside a direction of length 1, with the error of the response that lies along it.
    pub(super) fn fit_beside(
        &self,
        whitened: &Whitened,
        cells: &[&Cell],
        beside: Option<(&Vector, f64)>,
    ) -> Fit {
        let n = whitened.count;
        let weighted = |values: &[f64]| -> Vector {
            let mut weighted = [0.0; MAX_NUMBERS];
            for (slot, (value, weight)) in weighted.iter_mut().zip(values.iter().zip(&whitened.weights)) {
                *slot = value * weight;
            }
            weighted
        };
        let projected = |mut vector: Vector| -> Vector {
            if let Some((beside, _)) = beside {
                let along = dot(&vector[..n], &beside[..n]);
                for (value, direction) in vector.iter_mut().zip(beside) {
                    *value -= along * direction;
                }
            }
            vector
        };
        let mut rest = whitened.change;
        let whole = dot(&rest[..n], &rest[..n]);
        let mut scale = 1.0;
        let mut directions = [[0.0; MAX_NUMBERS]; MOST_DIRECTIONS];
        let mut rank = 0;
        for (place, cell) in cells.iter().enumerate() {
            // The last cell's response is the change, or most of it: its error goes by that, whichever cell it is.
            let is_last = place + 1 == cells.len();
            let mean = weighted(self.mean_of(cell));
            let mut length = if is_last { whole } else { dot(&mean[..n], &mean[..n]) };
            for (value, mean) in rest.iter_mut().zip(&mean) {
                *value -= mean;
            }
            for which in 0..cell.rank {
                let direction = weighted(self.direction_of(cell, which));
                if !is_last {
                    length += dot(&direction[..n], &direction[..n]);
                }
                directions[rank] = projected(direction);
                rank += 1;
            }
            // The response beside may be all of the change: what its law leaves must not be held against a cell that is exact.
            let error = beside.map_or(cell.error, |(_, error)| cell.error.max(error));
            scale += error * error * length / n as f64;
        }
        let rest = projected(rest);
        let (mut factor, mut along) = ([[0.0; MOST_DIRECTIONS]; MOST_DIRECTIONS], [0.0; MOST_DIRECTIONS]);
        for i in 0..rank {
            along[i] = dot(&directions[i][..n], &rest[..n]);
            for j in 0..=i {
                factor[i][j] = dot(&directions[i][..n], &directions[j][..n]);
            }
            factor[i][i] += scale;
        }
        let log_determinant = cholesky(&mut factor, rank);
        let projections = along;
        solve(&factor, rank, &mut along);
        let explained: f64 = projections.iter().zip(&along).map(|(a, b)| a * b).sum();
        let square = (dot(&rest[..n], &rest[..n]) - explained).max(0.0) / scale;
        let log_likelihood = -0.5 * (square + (n - rank) as f64 * libm::log(scale) + log_determinant);
        Fit { log_likelihood, distance: square / n as f64, along, factor, rank, scale }
    }
}

/// Rounding is no smaller than this noise, share² of full command.
const LEAST_VARIANCE: f64 = 1e-12;

type Factor = [[f64; MOST_DIRECTIONS]; MOST_DIRECTIONS];

/// Factors a positive definite matrix in place; the logarithm of its determinant.
fn cholesky(matrix: &mut Factor, rank: usize) -> f64 {
    let mut log_determinant = 0.0;
    for i in 0..rank {
        for j in 0..=i {
            let inner: f64 = (0..j).map(|k| matrix[i][k] * matrix[j][k]).sum();
            let rest = matrix[i][j] - inner;
            matrix[i][j] = if i == j { libm::sqrt(rest.max(f64::MIN_POSITIVE)) } else { rest / matrix[j][j] };
        }
        log_determinant += 2.0 * libm::log(matrix[i][i]);
    }
    log_determinant
}

/// Solves `L Lᵀ x = b` in place.
fn solve(factor: &Factor, rank: usize, x: &mut [f64; MOST_DIRECTIONS]) {
    for i in 0..rank {
        let inner: f64 = (0..i).map(|k| factor[i][k] * x[k]).sum();
        x[i] = (x[i] - inner) / factor[i][i];
    }
    for i in (0..rank).rev() {
        let inner: f64 = (i + 1..rank).map(|k| factor[k][i] * x[k]).sum();
        x[i] = (x[i] - inner) / factor[i][i];
    }
}

/// Size and variance of a cell's cause whose directions begin at `from`.
fn size(
    cell: &Cell,
    from: usize,
    along: &[f64; MOST_DIRECTIONS],
    (factor, rank, scale): (&Factor, usize, f64),
) -> (f64, f64) {
    let mut loadings = [0.0; MOST_DIRECTIONS];
    for (slot, loading) in loadings.iter_mut().skip(from).zip(cell.loadings.iter().take(cell.rank)) {
        *slot = *loading;
    }
    let moved: f64 = loadings.iter().zip(along).map(|(loading, along)| loading * along).sum();
    let mut solved = loadings;
    solve(factor, rank, &mut solved);
    let spread: f64 = loadings.iter().zip(&solved).map(|(a, b)| a * b).sum();
    (cell.size + moved, scale * spread + cell.rest * cell.rest)
}
