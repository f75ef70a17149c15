//! How well a hypothesis explains a change: a normal likelihood whose covariance is that of a factor analysis, by Woodbury's identity.

use super::linear::{applied, square};
use super::sizes::{Cut, cut};
use super::{Causes, Cell, Change, MAX_NUMBERS, MAX_RANK};

/// Most directions of a hypothesis: those of two cells.
const MOST_DIRECTIONS: usize = 2 * MAX_RANK;

/// A change in whitened coordinates, those beyond the model's 0. Their number is known to the compiler, so that sums over them are of one
/// piece.
pub(super) struct Whitened<const N: usize> {
    pub(super) count: usize,
    /// What a coordinate is multiplied by.
    pub(super) weights: [f64; N],
    /// The change.
    pub(super) change: [f64; N],
    /// The same in coordinates of noise alone.
    pub(super) in_noise: [f64; N],
    /// Variance of each coordinate where those of noise alone have 1.
    pub(super) of_noise: [f64; N],
}

impl<const N: usize> Whitened<N> {
    /// Squared length of the change along directions of length 1, at right angles, and beside them.
    pub(super) fn parted(&self, directions: &[[f64; N]]) -> [f64; 2] {
        let along: f64 =
            directions.iter().map(|direction| dot(&self.change, direction)).map(|along| along * along).sum();
        [along, (dot(&self.change, &self.change) - along).max(0.0)]
    }

    /// Directions of length 1, at right angles, that span two rows of numbers; 0 where there is nothing left to span.
    pub(super) fn span(&self, [first, second]: [&[f64]; 2]) -> [[f64; N]; 2] {
        let first = of_length_1(self.weighted(first));
        let mut second = self.weighted(second);
        let along = dot(&first, &second);
        for (value, first) in second.iter_mut().zip(&first) {
            *value -= along * first;
        }
        [first, of_length_1(second)]
    }

    /// Numbers in these coordinates.
    fn weighted(&self, values: &[f64]) -> [f64; N] {
        let mut weighted = [0.0; N];
        for (slot, (value, weight)) in weighted.iter_mut().zip(values.iter().zip(&self.weights)) {
            *slot = value * weight;
        }
        weighted
    }
}

/// A hypothesis, fitted.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    pub(super) log_likelihood: f64,
    /// Squared distance over the number of coordinates.
    pub(super) distance: f64,
    /// Factor of the directions' precision, their number, the change along them before the factor's transpose is solved for, and the
    /// variance of a coordinate that they leave.
    factor: Factor,
    rank: usize,
    forward: [f64; MOST_DIRECTIONS],
    scale: f64,
}

impl Fit {
    /// Of a cause that follows any law, as this one, or one that training has simulated, half of all each: the likelier says the sizes.
    pub(super) fn or(self, simulated: Fit) -> Fit {
        let is_simulated = simulated.log_likelihood > self.log_likelihood;
        let (likelier, other) = if is_simulated { (simulated, self) } else { (self, simulated) };
        let both = 0.5 * (1.0 + libm::exp(other.log_likelihood - likelier.log_likelihood));
        Fit { log_likelihood: likelier.log_likelihood + libm::log(both), distance: self.distance, ..likelier }
    }

    /// The fit of a change in units whose covariance has this logarithm of a determinant.
    pub(super) fn in_units_of(self, log_determinant: f64) -> Fit {
        Fit { log_likelihood: self.log_likelihood - 0.5 * log_determinant, ..self }
    }

    /// Where along each direction the change lies, standard deviations: those of the first cell, then those of the second.
    pub(super) fn along(&self) -> [f64; MOST_DIRECTIONS] {
        let mut along = self.forward;
        solve_transposed(&self.factor, self.rank, &mut along);
        along
    }

    /// Size of each fitted cell's cause, cut to what training has simulated. Apart from the fit, since of hundreds of hypotheses few have
    /// any weight.
    pub(super) fn sizes(&self, cells: &[&Cell]) -> [Cut; 2] {
        let mut sizes = [Cut { log_share: 0.0, mean: 0.0, variance: 0.0 }; 2];
        let mut from = 0;
        for (slot, cell) in sizes.iter_mut().zip(cells) {
            let uncut = self.size(cell, from);
            *slot = cut(uncut, cell.simulated);
            from += cell.rank;
        }
        sizes
    }

    /// Size and variance of a cell's cause whose directions begin at `from`: loadings times what the precision's inverse makes of the change,
    /// and of themselves; both are products of what the factor alone makes.
    fn size(&self, cell: &Cell, from: usize) -> (f64, f64) {
        let mut loadings = [0.0; MOST_DIRECTIONS];
        for (slot, loading) in loadings.iter_mut().skip(from).zip(cell.loadings.iter().take(cell.rank)) {
            *slot = *loading;
        }
        solve(&self.factor, self.rank, &mut loadings);
        let moved: f64 = loadings.iter().zip(&self.forward).map(|(loading, along)| loading * along).sum();
        let spread: f64 = loadings.iter().map(|loading| loading * loading).sum();
        (cell.size + moved, self.scale * spread + cell.rest * cell.rest)
    }

    /// Logarithm of the likelihood with the sizes cut to what training has simulated.
    pub(super) fn log_likelihood_of_simulated_sizes(&self, cells: &[&Cell]) -> f64 {
        self.log_likelihood + self.sizes(cells).iter().map(|size| size.log_share).sum::<f64>()
    }
}

fn of_length_1<const N: usize>(vector: [f64; N]) -> [f64; N] {
    let length = libm::sqrt(dot(&vector, &vector)).max(f64::MIN_POSITIVE);
    vector.map(|value| value / length)
}

pub(super) fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    const { assert!(N.is_multiple_of(4)) };
    // Four sums side by side: additions wait for each other otherwise.
    let mut sums = [0.0; 4];
    for (a, b) in a.as_chunks::<4>().0.iter().zip(b.as_chunks::<4>().0) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

impl Causes {
    /// The change in coordinates in which noise and ordinary variation together have variance 1.
    pub(super) fn whitened<const N: usize>(&self, change: &Change<'_>) -> Whitened<N> {
        let count = self.numbers();
        let (mut weights, mut own) = ([0.0; N], [0.0; N]);
        let noise = change.noise * change.noise + LEAST_VARIANCE;
        let coordinates = applied(count, &self.file.basis, change.numbers).zip(&self.file.ordinary);
        for ((weight, value), (coordinate, ordinary)) in weights.iter_mut().zip(&mut own).zip(coordinates) {
            *weight = 1.0 / libm::sqrt(noise + ordinary);
            *value = coordinate;
        }
        let (mut in_noise, mut of_noise) = (own, [1.0; N]);
        if let Some(noise) = &self.in_noise {
            let coordinates = applied(count, &noise.basis, change.numbers).zip(&noise.variances);
            for ((value, own), (coordinate, variance)) in
                in_noise.iter_mut().zip(&mut of_noise).zip(coordinates)
            {
                (*value, *own) = (coordinate, *variance);
            }
        }
        let mut whitened = Whitened { count, weights, change: own, in_noise, of_noise };
        whitened.change.iter_mut().zip(&weights).for_each(|(value, weight)| *value *= weight);
        whitened
    }

    /// Squared distance over the number of coordinates between two readings of one machine, of which noise and ordinary variation give 1.
    pub fn distance(&self, difference: &Change<'_>) -> f64 {
        let whitened = self.whitened::<MAX_NUMBERS>(difference);
        dot(&whitened.change, &whitened.change) / whitened.count.max(1) as f64
    }

    /// Standard deviation of the noise on the command with which the phases' means scatter like this from cycle to cycle: the median over
    /// phases.
    pub fn noise_of(&self, deviations: &[f64]) -> f64 {
        let n = self.numbers().max(1);
        let mut noise = [0.0; MAX_NUMBERS];
        let rows = self.file.inverse.chunks_exact(n);
        let count = deviations.len().min(n);
        for (slot, (deviation, row)) in noise.iter_mut().zip(deviations.iter().zip(rows)) {
            let length = libm::sqrt(square(row));
            *slot = deviation / length.max(f64::MIN_POSITIVE);
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
    pub(super) fn fit<const N: usize>(&self, whitened: &Whitened<N>, cells: &[&Cell]) -> Fit {
        if self.file.errors_are_even {
            return self.fit_evenly(whitened, cells);
        }
        self.lay(whitened, cells).moments.fit(whitened.count)
    }

    /// Lays cells beside a change.
    pub(super) fn lay<const N: usize>(&self, whitened: &Whitened<N>, cells: &[&Cell]) -> Laid<N> {
        let mut rest = whitened.change;
        let mut directions = [[0.0; N]; MOST_DIRECTIONS];
        let (mut rank, mut scale, mut simulated) = (0, 1.0, 1.0);
        for (place, cell) in cells.iter().enumerate() {
            // The last cell's response is what the cell before it leaves of the change, or most of it: its error goes by that, whichever
            // cell it is.
            let is_last = place + 1 == cells.len();
            let mean = whitened.weighted(self.mean_of(cell));
            let mut length = if is_last { dot(&rest, &rest) } else { dot(&mean, &mean) };
            for (value, mean) in rest.iter_mut().zip(&mean) {
                *value -= mean;
            }
            for which in 0..cell.rank {
                let direction = whitened.weighted(self.direction_of(cell, which));
                if !is_last {
                    length += dot(&direction, &direction);
                }
                directions[rank] = direction;
                rank += 1;
            }
            let length = length / whitened.count as f64;
            scale += cell.error * cell.error * length;
            simulated += cell.simulated_error_squared() * length;
        }
        let (mut products, mut along) = ([[0.0; MOST_DIRECTIONS]; MOST_DIRECTIONS], [0.0; MOST_DIRECTIONS]);
        for i in 0..rank {
            along[i] = dot(&directions[i], &rest);
            for j in 0..=i {
                products[i][j] = dot(&directions[i], &directions[j]);
            }
        }
        let moments = Moments { square: dot(&rest, &rest), along, products, rank, scale, simulated };
        Laid { rest, directions, moments }
    }
}

/// Cells beside a change: what their means leave of it, their directions, and what a fit needs of these.
pub(super) struct Laid<const N: usize> {
    rest: [f64; N],
    directions: [[f64; N]; MOST_DIRECTIONS],
    pub(super) moments: Moments,
}

impl<const N: usize> Laid<N> {
    /// What is left of them beside directions of length 1, at right angles, with a variance of its own.
    pub(super) fn beside(&self, directions: &[[f64; N]], [scale, simulated]: [f64; 2]) -> Moments {
        let mut moments = self.moments;
        for direction in directions {
            let mut shares = [0.0; MOST_DIRECTIONS];
            for (share, own) in shares.iter_mut().zip(&self.directions).take(moments.rank) {
                *share = dot(own, direction);
            }
            let rest = dot(&self.rest, direction);
            moments.square -= rest * rest;
            for i in 0..moments.rank {
                moments.along[i] -= shares[i] * rest;
                for j in 0..=i {
                    moments.products[i][j] -= shares[i] * shares[j];
                }
            }
        }
        (moments.scale, moments.simulated) = (scale, simulated);
        moments
    }
}

/// A leak of any size, beside which other causes are tried.
pub(super) struct AnyLeak<'c, const N: usize> {
    /// Responses of a small one and one of a middle size.
    pub(super) means: [&'c [f64]; 2],
    /// Directions of length 1, at right angles, that span them.
    pub(super) directions: [[f64; N]; 2],
    /// Squared length of what its law may leave.
    pub(super) error: f64,
    /// Squared length of the change beside the directions.
    pub(super) left: f64,
}

impl<const N: usize> AnyLeak<'_, N> {
    /// Variance that its law and that of a cell beside it leave each of so many coordinates: any law, and one that training has simulated.
    pub(super) fn variances_beside(&self, cell: &Cell, count: usize) -> [f64; 2] {
        let own = [cell.error * cell.error, cell.simulated_error_squared()];
        own.map(|own| (self.error + own * self.left) / count as f64)
    }

    /// What a fit needs of a cell beside it.
    pub(super) fn moments_beside(&self, laid: &Laid<N>, cell: &Cell, count: usize) -> Moments {
        laid.beside(&self.directions, self.variances_beside(cell, count).map(|variance| 1.0 + variance))
    }
}

/// Error of a response, over its length, that cells have for laws that nobody has simulated.
pub const UNKNOWN_LAW_ERROR: f64 = 0.2;
/// What of it is left where a law has been.
const KNOWN_LAW_ERROR: f64 = 0.05;

impl Cell {
    /// Square of the error where the law is one of those that training has simulated.
    pub(super) fn simulated_error_squared(&self) -> f64 {
        let error = self.error * self.error;
        if self.error < UNKNOWN_LAW_ERROR {
            error
        } else {
            error - UNKNOWN_LAW_ERROR * UNKNOWN_LAW_ERROR + KNOWN_LAW_ERROR * KNOWN_LAW_ERROR
        }
    }
}

/// What a fit needs of cells and a change.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moments {
    /// Squared length of what the means leave of the change.
    square: f64,
    /// What of it lies along each direction, and the directions' products.
    along: [f64; MOST_DIRECTIONS],
    products: Factor,
    rank: usize,
    /// Variance of a coordinate that the directions leave, and the same where the law is one of those that training has simulated.
    scale: f64,
    simulated: f64,
}

impl Moments {
    /// Fits, in so many coordinates, under any law or one that training has simulated.
    pub(super) fn fit(&self, n: usize) -> Fit {
        self.fit_beside(n, &self.projected(self.scale))
    }

    /// The same, if the logarithm of the likelihood may reach `least`. Many hypotheses are so far off that their distance alone says no: no
    /// variance is below 1, so that determinants take nothing less than 0 off, and under the larger of the two the change is nearest.
    pub(super) fn fit_from(&self, n: usize, least: f64) -> Option<Fit> {
        let any = self.projected(self.scale);
        (-0.5 * any.square >= least).then(|| self.fit_beside(n, &any))
    }

    /// Fits, given what the change is under any law.
    fn fit_beside(&self, n: usize, any: &Projected) -> Fit {
        let any = any.fit(n, self.rank);
        if self.simulated < self.scale { any.or(self.fit_under_one(n, self.simulated)) } else { any }
    }

    /// Fits where the directions leave a variance.
    pub(super) fn fit_under_one(&self, n: usize, scale: f64) -> Fit {
        self.projected(scale).fit(n, self.rank)
    }

    fn projected(&self, scale: f64) -> Projected {
        // Cells have two directions: a number that the compiler knows has its loops unrolled.
        match self.rank {
            2 => self.projected_in(2, scale),
            rank => self.projected_in(rank, scale),
        }
    }

    #[inline(always)]
    fn projected_in(&self, rank: usize, scale: f64) -> Projected {
        let Moments { square, along: mut forward, products: mut factor, .. } = *self;
        for (i, row) in factor.iter_mut().enumerate().take(rank) {
            row[i] += scale;
        }
        let root_of_determinant = cholesky(&mut factor, rank);
        solve(&factor, rank, &mut forward);
        let explained: f64 = forward.iter().take(rank).map(|value| value * value).sum();
        let square = (square - explained).max(0.0) / scale;
        Projected { square, forward, factor, root_of_determinant, scale }
    }
}

/// A change on directions that leave a variance.
struct Projected {
    /// Squared distance.
    square: f64,
    forward: [f64; MOST_DIRECTIONS],
    factor: Factor,
    root_of_determinant: f64,
    scale: f64,
}

impl Projected {
    fn fit(&self, n: usize, rank: usize) -> Fit {
        let Projected { square, forward, factor, root_of_determinant, scale } = *self;
        let log_determinant = 2.0 * libm::log(root_of_determinant);
        let log_likelihood = -0.5 * (square + (n - rank) as f64 * libm::log(scale) + log_determinant);
        Fit { log_likelihood, distance: square / n as f64, factor, rank, forward, scale }
    }
}

/// Rounding is no smaller than this noise, share² of full command.
const LEAST_VARIANCE: f64 = 1e-12;

type Factor = [[f64; MOST_DIRECTIONS]; MOST_DIRECTIONS];

/// Factors a positive definite matrix in place, with the reciprocals of the factor's diagonal on its diagonal; the square root of its
/// determinant.
#[inline(always)]
fn cholesky(matrix: &mut Factor, rank: usize) -> f64 {
    let mut root = 1.0;
    for i in 0..rank {
        for j in 0..=i {
            let inner: f64 = (0..j).map(|k| matrix[i][k] * matrix[j][k]).sum();
            let rest = matrix[i][j] - inner;
            if i == j {
                let diagonal = libm::sqrt(rest.max(f64::MIN_POSITIVE));
                root *= diagonal;
                matrix[i][i] = 1.0 / diagonal;
            } else {
                matrix[i][j] = rest * matrix[j][j];
            }
        }
    }
    root
}

/// Solves `L x = b` in place.
#[inline(always)]
fn solve(factor: &Factor, rank: usize, x: &mut [f64; MOST_DIRECTIONS]) {
    for i in 0..rank {
        let inner: f64 = (0..i).map(|k| factor[i][k] * x[k]).sum();
        x[i] = (x[i] - inner) * factor[i][i];
    }
}

/// Solves `Lᵀ x = b` in place.
fn solve_transposed(factor: &Factor, rank: usize, x: &mut [f64; MOST_DIRECTIONS]) {
    for i in (0..rank).rev() {
        let inner: f64 = (i + 1..rank).map(|k| factor[k][i] * x[k]).sum();
        x[i] = (x[i] - inner) * factor[i][i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(square: f64, scale: f64, simulated: f64) -> Moments {
        Moments {
            square,
            along: [0.0; MOST_DIRECTIONS],
            products: [[0.0; MOST_DIRECTIONS]; MOST_DIRECTIONS],
            rank: 0,
            scale,
            simulated,
        }
    }

    /// Normal likelihoods of four coordinates with variances 9 and 4, half each.
    #[test]
    fn analytic_a_law_is_one_that_was_simulated_or_another() {
        let given = moments(20.0, 9.0, 4.0).fit(4).log_likelihood;
        let density = |variance: f64| libm::exp(-0.5 * 20.0 / variance) / (variance * variance);
        assert!((given - libm::log(0.5 * (density(9.0) + density(4.0)))).abs() < 1e-12, "{given}");
    }

    #[test]
    fn neutral_a_response_without_such_an_error_has_one_likelihood() {
        let of_one = moments(20.0, 4.0, 4.0);
        assert_eq!(of_one.fit(4).log_likelihood, of_one.projected(4.0).fit(4, 0).log_likelihood);
    }

    /// A bound that passes has the very fit; one that does not is above the likelihood.
    #[test]
    fn what_cannot_reach_a_bound_is_not_fitted() {
        let one = moments(20.0, 9.0, 4.0);
        let given = one.fit(4).log_likelihood;
        // The distance under the larger variance: 20 over 9.
        let bound = -10.0 / 9.0;
        assert!(given < bound);
        assert_eq!(one.fit_from(4, bound).unwrap().log_likelihood, given);
        assert!(one.fit_from(4, bound + 1e-9).is_none());
    }

    /// Beside the directions that span a leak of any size nothing is left of one.
    #[test]
    fn directions_of_length_1_span_both_rows() {
        let (in_noise, of_noise) = ([3.0, 1.0, 0.0, 0.5], [1.0; 4]);
        let whitened =
            Whitened { count: 4, weights: [2.0; 4], change: [6.0, 2.0, 0.0, 1.0], in_noise, of_noise };
        let directions = whitened.span([&[1.0, 0.0, 0.0, 0.0], &[1.0, 1.0, 0.0, 0.0]]);
        assert_eq!(directions, [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]);
        assert_eq!(whitened.parted(&directions), [40.0, 1.0]);
    }
}
