//! Exponential, logarithm, power and hyperbolic tangent, and a fourth root, without branches or tables, so that they run in lanes, with the same bits in a
//! lane and alone and on every instruction set.
//!
//! The range reductions are those of Cody and Waite (Software Manual for the Elementary Functions, 1980). Within the arguments
//! that laws have (|x| ≤ 700, normal positive bases) `exp` and `ln` are right to 5e-16 of their value and `tanh` to 5e-16 of 1; `pow` to
//! 5e-16 times 1 + |y ln x|. Beyond, `exp` stops at the ends of its range, and `ln` takes what is not a normal positive number for the
//! smallest one: nothing becomes infinite or NaN that was not.

/// Added to a number below 2^51, it leaves the nearest integer in the low bits.
const ROUNDING: f64 = 6_755_399_441_055_744.0;
/// ln 2 in two parts, the first short enough that its product with an exponent is exact.
const LN_2: (f64, f64) = (6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10);
/// Arguments of `exp` end here, short of where its values end.
const LARGEST: f64 = 708.0;
/// 1 / k! for k = 13 … 0.
const EXP: [f64; 14] = [
    1.0 / 6_227_020_800.0,
    1.0 / 479_001_600.0,
    1.0 / 39_916_800.0,
    1.0 / 3_628_800.0,
    1.0 / 362_880.0,
    1.0 / 40_320.0,
    1.0 / 5_040.0,
    1.0 / 720.0,
    1.0 / 120.0,
    1.0 / 24.0,
    1.0 / 6.0,
    0.5,
    1.0,
    1.0,
];
/// 1 / (2 k + 1) for k = 10 … 1.
const ARTANH: [f64; 10] = [
    1.0 / 21.0,
    1.0 / 19.0,
    1.0 / 17.0,
    1.0 / 15.0,
    1.0 / 13.0,
    1.0 / 11.0,
    1.0 / 9.0,
    1.0 / 7.0,
    1.0 / 5.0,
    1.0 / 3.0,
];
/// Bits of √½: what is at or above it, in its octave, has a mantissa of √½ … √2.
const ROOT_HALF: u64 = 0x3fe6_a09e_667f_3bcd;
/// Bits of 2^52: an integer in the low bits makes it that much larger.
const TWO_TO_52: u64 = 0x4330_0000_0000_0000;

/// A quarter of a number's bits taken from these are those of one over its fourth root, within 3 %: an exponent goes to its quarter,
/// and a mantissa, nearly a logarithm, with it (Blinn, IEEE Computer Graphics and Applications 17 (1997), of square roots). The offset of
/// 0.062 makes both errors alike.
const FOURTH_ROOT_OF_BITS: u64 = 0x4feb_020c_49ba_5e35;
/// Coefficients of (1 − e)^−¼ − 1.
const BINOMIAL: [f64; 3] = [1.0 / 4.0, 5.0 / 32.0, 15.0 / 128.0];

/// e to the power of `x`.
#[inline(always)]
pub(crate) fn exp(x: f64) -> f64 {
    let x = if x > LARGEST { LARGEST } else { x };
    let x = if x < -LARGEST { -LARGEST } else { x };
    let rounded = x * std::f64::consts::LOG2_E + ROUNDING;
    let octaves = rounded - ROUNDING;
    let rest = x - octaves * LN_2.0 - octaves * LN_2.1;
    let mut sum = EXP[0];
    for factor in &EXP[1..] {
        sum = sum * rest + factor;
    }
    let exponent = rounded.to_bits().wrapping_sub(ROUNDING.to_bits()).wrapping_add(1023);
    sum * f64::from_bits(exponent << 52)
}

/// The natural logarithm of `x`.
#[inline(always)]
pub(crate) fn ln(x: f64) -> f64 {
    let x = if x < f64::MIN_POSITIVE { f64::MIN_POSITIVE } else { x };
    let above = x.to_bits().wrapping_sub(ROOT_HALF).wrapping_add(1023 << 52);
    let octaves = f64::from_bits(TWO_TO_52 | (above >> 52)) - (f64::from_bits(TWO_TO_52) + 1023.0);
    let mantissa = f64::from_bits((above & 0x000f_ffff_ffff_ffff).wrapping_add(ROOT_HALF));
    // ln m = 2 artanh ((m − 1) / (m + 1)).
    let ratio = (mantissa - 1.0) / (mantissa + 1.0);
    let square = ratio * ratio;
    let mut sum = ARTANH[0];
    for factor in &ARTANH[1..] {
        sum = sum * square + factor;
    }
    let twice = ratio + ratio;
    octaves * LN_2.0 + (twice + (twice * square * sum + octaves * LN_2.1))
}

/// One over the fourth root of `x`, for normal positive `x`: from the halves of its exponent, twice corrected by three terms of the
/// binomial series of (1 − e)^−¼ in e = 1 − x y⁴. Multiplications and additions alone: two square roots and a division in lanes take three
/// times as long.
#[inline(always)]
pub(crate) fn reciprocal_fourth_root(x: f64) -> f64 {
    let mut y = f64::from_bits(FOURTH_ROOT_OF_BITS.wrapping_sub(x.to_bits() >> 2));
    for _ in 0..2 {
        let square = y * y;
        let e = 1.0 - x * (square * square);
        y += y * (e * (BINOMIAL[0] + e * (BINOMIAL[1] + e * BINOMIAL[2])));
    }
    y
}

/// `x` to the power of `y`, for positive `x`.
#[inline(always)]
pub(crate) fn pow(x: f64, y: f64) -> f64 {
    exp(y * ln(x))
}

/// The hyperbolic tangent of `x`.
#[inline(always)]
pub(crate) fn tanh(x: f64) -> f64 {
    let size = 1.0 - 2.0 / (exp(2.0 * x.abs()) + 1.0);
    if x < 0.0 { -size } else { size }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::{LANES, Lanes, Real};

    /// Largest difference from `libm` over its scale.
    fn largest(
        from: f64,
        to: f64,
        ours: impl Fn(f64) -> f64,
        theirs: impl Fn(f64) -> f64,
        scale: impl Fn(f64) -> f64,
    ) -> f64 {
        const STEPS: u32 = 200_003;
        (0..=STEPS)
            .map(|step| from + (to - from) * f64::from(step) / f64::from(STEPS))
            .map(|x| (ours(x) - theirs(x)).abs() / scale(x))
            .fold(0.0, f64::max)
    }

    #[test]
    fn they_are_those_of_libm_to_the_stated_error() {
        assert!(largest(-700.0, 700.0, exp, libm::exp, libm::exp) < 5e-16);
        assert!(largest(-1.0, 1.0, exp, libm::exp, libm::exp) < 5e-16);
        let of_value = |x: f64| libm::log(x).abs().max(f64::MIN_POSITIVE);
        assert!(largest(0.5, 2.0, ln, libm::log, of_value) < 5e-16);
        assert!(largest(1e-12, 1e3, ln, libm::log, of_value) < 5e-16);
        assert!(largest(1e9, 1e15, ln, libm::log, of_value) < 5e-16);
        assert!(largest(-30.0, 30.0, tanh, libm::tanh, |_| 1.0) < 5e-16);
        let of_root = |x: f64| 1.0 / libm::sqrt(libm::sqrt(x));
        assert!(largest(1e-3, 20.0, reciprocal_fourth_root, of_root, of_root) < 5e-16);
        assert!(largest(1e8, 1e16, reciprocal_fourth_root, of_root, of_root) < 5e-16);
        for y in [-0.9, -0.25, 0.3, 0.77, 1.5] {
            let error = |x: f64| libm::pow(x, y) * (1.0 + (y * libm::log(x)).abs());
            assert!(largest(1e-4, 1.0, |x| pow(x, y), |x| libm::pow(x, y), error) < 5e-16);
            assert!(largest(1e10, 1e15, |x| pow(x, y), |x| libm::pow(x, y), error) < 5e-16);
        }
    }

    #[test]
    fn they_are_exact_where_that_matters() {
        assert_eq!((exp(0.0), ln(1.0), tanh(0.0), pow(0.3, 0.0)), (1.0, 0.0, 0.0, 1.0));
        assert_eq!((tanh(40.0), tanh(-40.0)), (1.0, -1.0));
        assert_eq!(tanh(-0.37), -tanh(0.37));
    }

    #[test]
    fn nothing_but_nan_becomes_infinite_or_nan() {
        for x in [f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN, 0.0, -0.0, -1.0, 5e-324] {
            assert!(exp(x).is_finite() && tanh(x).is_finite() && ln(x.min(f64::MAX)).is_finite(), "{x}");
        }
        assert!(exp(f64::NAN).is_nan() && tanh(f64::NAN).is_nan());
    }

    #[test]
    fn a_lane_has_the_bits_of_one_alone() {
        for step in 0..5_000 {
            let of = |lane: usize| 1e-3 + 0.37 * f64::from(step) * (lane as f64 + 0.5);
            let lanes = Lanes::from_lanes(of);
            type Alone = fn(f64) -> f64;
            let functions: [(Lanes, Alone); 5] = [
                ((-lanes).exp(), |x| exp(-x)),
                (lanes.ln(), ln),
                (lanes.tanh(), tanh),
                (lanes.reciprocal_fourth_root(), reciprocal_fourth_root),
                (lanes.pow(Lanes::splat(0.77)), |x| pow(x, 0.77)),
            ];
            for (lanes, alone) in functions {
                for lane in 0..LANES {
                    assert_eq!(lanes.lane(lane).to_bits(), alone(of(lane)).to_bits());
                }
            }
        }
    }
}
