//! One number, or the same number of many machines side by side.
//!
//! The equations are written once over [`Real`]. `f64` runs one machine; [`Lanes`] runs as many as it has
//! lanes. No operation mixes lanes or contracts a multiply-add, so a lane gives the very bits that the
//! scalar machine gives.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use crate::effects::{Effect, Law};
use crate::elementary;

/// Number of machines that the batched path steps together: one AVX-512 register, two of AVX2.
pub const LANES: usize = 8;

/// A number of one machine (`f64`), or of several machines in lanes.
pub trait Real:
    Copy
    + Send
    + Sync
    + std::fmt::Debug
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + 'static
{
    /// How many machines.
    const WIDTH: usize;

    /// The same value for every machine.
    fn splat(value: f64) -> Self;
    /// A value for each machine; `value` is asked for lanes 0 … `WIDTH` − 1.
    fn from_lanes(value: impl FnMut(usize) -> f64) -> Self;
    /// The value of one machine.
    fn lane(self, lane: usize) -> f64;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Magnitude.
    fn abs(self) -> Self;
    /// e to the power of it; arguments beyond ±708 count as that.
    fn exp(self) -> Self;
    /// Natural logarithm; what is not a normal positive number counts as the smallest one.
    fn ln(self) -> Self;
    /// Hyperbolic tangent.
    fn tanh(self) -> Self;
    /// To a power, for positive numbers.
    fn pow(self, exponent: Self) -> Self;
    /// One over the fourth root, for positive numbers.
    fn reciprocal_fourth_root(self) -> Self;
    /// The larger of the two.
    fn max(self, other: Self) -> Self;
    /// The smaller of the two.
    fn min(self, other: Self) -> Self;
    /// `if_positive` where `self > 0`, else `otherwise`.
    fn where_positive(self, if_positive: Self, otherwise: Self) -> Self;
    /// Builds the effect's law for this number type; `None` where every machine is at its neutral value.
    fn law(effect: &dyn Effect, values: &[Self]) -> Option<Box<dyn Law<Self>>>;

    /// A scalar function of each machine's value.
    #[inline(always)]
    fn map(self, mut function: impl FnMut(f64) -> f64) -> Self {
        Self::from_lanes(|lane| function(self.lane(lane)))
    }
}

impl Real for f64 {
    const WIDTH: usize = 1;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn from_lanes(mut value: impl FnMut(usize) -> f64) -> Self {
        value(0)
    }
    #[inline(always)]
    fn lane(self, _lane: usize) -> f64 {
        self
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f64::abs(self)
    }
    fn exp(self) -> Self {
        elementary::exp(self)
    }
    fn ln(self) -> Self {
        elementary::ln(self)
    }
    fn tanh(self) -> Self {
        elementary::tanh(self)
    }
    fn pow(self, exponent: Self) -> Self {
        elementary::pow(self, exponent)
    }
    #[inline(always)]
    fn reciprocal_fourth_root(self) -> Self {
        elementary::reciprocal_fourth_root(self)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    #[inline(always)]
    fn where_positive(self, if_positive: Self, otherwise: Self) -> Self {
        if self > 0.0 { if_positive } else { otherwise }
    }
    fn law(effect: &dyn Effect, values: &[Self]) -> Option<Box<dyn Law<Self>>> {
        if effect.is_neutral(values) { None } else { Some(effect.scalar(values)) }
    }
}

/// One number of each of [`LANES`] machines.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(64))]
pub struct Lanes(pub [f64; LANES]);

macro_rules! lanewise {
    ($($trait:ident $method:ident $op:tt),*) => {$(
        impl $trait for Lanes {
            type Output = Lanes;
            #[inline(always)]
            fn $method(self, other: Lanes) -> Lanes {
                let mut out = self;
                for lane in 0..LANES {
                    out.0[lane] $op other.0[lane];
                }
                out
            }
        }
    )*};
}
lanewise!(Add add +=, Sub sub -=, Mul mul *=, Div div /=);

impl Neg for Lanes {
    type Output = Lanes;
    #[inline(always)]
    fn neg(self) -> Lanes {
        self.lanewise(|a| -a)
    }
}
impl AddAssign for Lanes {
    #[inline(always)]
    fn add_assign(&mut self, other: Lanes) {
        *self = *self + other;
    }
}
impl SubAssign for Lanes {
    #[inline(always)]
    fn sub_assign(&mut self, other: Lanes) {
        *self = *self - other;
    }
}

impl Lanes {
    /// A function without branches of each lane.
    #[inline(always)]
    fn lanewise(mut self, function: impl Fn(f64) -> f64) -> Self {
        for a in &mut self.0 {
            *a = function(*a);
        }
        self
    }

    /// The same of each lane and its like.
    #[inline(always)]
    fn pairwise(mut self, other: Self, function: impl Fn(f64, f64) -> f64) -> Self {
        for lane in 0..LANES {
            self.0[lane] = function(self.0[lane], other.0[lane]);
        }
        self
    }
}

impl Real for Lanes {
    const WIDTH: usize = LANES;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Lanes([value; LANES])
    }
    #[inline(always)]
    fn from_lanes(mut value: impl FnMut(usize) -> f64) -> Self {
        let mut out = Lanes([0.0; LANES]);
        for (lane, slot) in out.0.iter_mut().enumerate() {
            *slot = value(lane);
        }
        out
    }
    #[inline(always)]
    fn lane(self, lane: usize) -> f64 {
        self.0[lane]
    }
    #[inline(always)]
    fn sqrt(mut self) -> Self {
        for a in &mut self.0 {
            *a = a.sqrt();
        }
        self
    }
    #[inline(always)]
    fn abs(mut self) -> Self {
        for a in &mut self.0 {
            *a = a.abs();
        }
        self
    }
    #[inline(always)]
    fn exp(self) -> Self {
        self.lanewise(elementary::exp)
    }
    #[inline(always)]
    fn ln(self) -> Self {
        self.lanewise(elementary::ln)
    }
    #[inline(always)]
    fn tanh(self) -> Self {
        self.lanewise(elementary::tanh)
    }
    #[inline(always)]
    fn pow(self, exponent: Self) -> Self {
        self.pairwise(exponent, elementary::pow)
    }
    #[inline(always)]
    fn reciprocal_fourth_root(self) -> Self {
        self.lanewise(elementary::reciprocal_fourth_root)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.pairwise(other, Real::max)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.pairwise(other, Real::min)
    }
    #[inline(always)]
    fn where_positive(self, if_positive: Self, otherwise: Self) -> Self {
        let mut out = otherwise;
        for lane in 0..LANES {
            out.0[lane] = self.0[lane].where_positive(if_positive.0[lane], otherwise.0[lane]);
        }
        out
    }
    fn law(effect: &dyn Effect, values: &[Self]) -> Option<Box<dyn Law<Self>>> {
        let neutral = |lane: usize| {
            let of_lane: Vec<f64> = values.iter().map(|value| value.lane(lane)).collect();
            effect.is_neutral(&of_lane)
        };
        if (0..LANES).all(neutral) { None } else { Some(effect.lanes(values)) }
    }
}
