//! The widest instructions that this processor has, picked when the program runs.

use crate::effects::Law;
#[cfg(target_arch = "x86_64")]
use crate::effects::{Constants, Moment, Openings, Sensing, Softening, Substep, Terms};
use crate::real::Lanes;

/// Instruction sets in which lanes are compiled.
#[derive(Clone, Copy)]
enum InstructionSet {
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// The platform's.
    Baseline,
}

impl InstructionSet {
    #[inline]
    fn widest() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            if std::arch::is_x86_feature_detected!("avx512f")
                && std::arch::is_x86_feature_detected!("avx512dq")
                && std::arch::is_x86_feature_detected!("avx512vl")
            {
                return InstructionSet::Avx512;
            }
            if std::arch::is_x86_feature_detected!("avx2") {
                return InstructionSet::Avx2;
            }
        }
        InstructionSet::Baseline
    }
}

/// Runs `work` compiled for the widest instruction set that the processor has: AVX-512, AVX2 or the
/// platform's baseline. What is to profit must be inlined into `work` (`#[inline(always)]`).
///
/// Results do not depend on the choice: no operation is contracted or reordered.
#[inline]
pub(crate) fn widest<R>(work: impl FnOnce() -> R) -> R {
    match InstructionSet::widest() {
        #[cfg(target_arch = "x86_64")]
        #[expect(unsafe_code, reason = "the processor has just been asked for these instructions")]
        InstructionSet::Avx512 => unsafe { with_avx512(work) },
        #[cfg(target_arch = "x86_64")]
        #[expect(unsafe_code, reason = "the processor has just been asked for these instructions")]
        InstructionSet::Avx2 => unsafe { with_avx2(work) },
        InstructionSet::Baseline => work(),
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx512vl")]
fn with_avx512<R>(work: impl FnOnce() -> R) -> R {
    work()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn with_avx2<R>(work: impl FnOnce() -> R) -> R {
    work()
}

/// A law of several machines, compiled for the widest instructions: laws are called through tables, where those of the caller end, and a
/// number that is written in halves and read as a whole is waited for.
pub(crate) fn law_in_lanes<L: Law<Lanes> + 'static>(law: L) -> Box<dyn Law<Lanes>> {
    match InstructionSet::widest() {
        #[cfg(target_arch = "x86_64")]
        InstructionSet::Avx512 => Box::new(WithAvx512(law)),
        #[cfg(target_arch = "x86_64")]
        InstructionSet::Avx2 => Box::new(WithAvx2(law)),
        InstructionSet::Baseline => Box::new(law),
    }
}

/// A law whose functions are compiled for an instruction set; made where the processor has it.
#[cfg(target_arch = "x86_64")]
macro_rules! law_with {
    ($name:ident, $with:ident) => {
        struct $name<L>(L);

        impl<L> $name<L> {
            /// Runs what is inlined into it under these instructions.
            #[inline(always)]
            fn run<R>(work: impl FnOnce() -> R) -> R {
                #[expect(unsafe_code, reason = "made where the processor has these instructions")]
                unsafe {
                    $with(work)
                }
            }
        }

        impl<L: Law<Lanes>> Law<Lanes> for $name<L> {
            fn memory(&self) -> usize {
                self.0.memory()
            }
            fn is_in_balances(&self) -> bool {
                self.0.is_in_balances()
            }
            fn softens(&self) -> bool {
                self.0.softens()
            }
            fn goes_by_steps(&self) -> bool {
                self.0.goes_by_steps()
            }
            fn has_states(&self) -> bool {
                self.0.has_states()
            }
            fn adjust(&self, constants: &mut Constants<'_, Lanes>) {
                self.0.adjust(constants);
            }
            fn correct(&self, error: Lanes) -> Lanes {
                self.0.correct(error)
            }
            fn sense(&self, memory: &mut [Lanes], position: Lanes, sensing: &Sensing<Lanes>) -> Lanes {
                Self::run(
                    #[inline(always)]
                    || self.0.sense(memory, position, sensing),
                )
            }
            fn spool(&self, memory: &mut [Lanes], command: Lanes, substep: &Substep<Lanes>) -> Lanes {
                Self::run(
                    #[inline(always)]
                    || self.0.spool(memory, command, substep),
                )
            }
            fn open(&self, moment: &Moment<'_, Lanes>, openings: &mut Openings<Lanes>) {
                Self::run(
                    #[inline(always)]
                    || self.0.open(moment, openings),
                );
            }
            fn act(&self, memory: &[Lanes], moment: &Moment<'_, Lanes>, terms: &mut Terms<Lanes>) {
                Self::run(
                    #[inline(always)]
                    || self.0.act(memory, moment, terms),
                );
            }
            fn soften(&self, moment: &Moment<'_, Lanes>, softening: &mut Softening<Lanes>) {
                Self::run(
                    #[inline(always)]
                    || self.0.soften(moment, softening),
                );
            }
            fn advance(
                &self,
                memory: &mut [Lanes],
                moment: &Moment<'_, Lanes>,
                terms: &Terms<Lanes>,
                dt: Lanes,
            ) {
                Self::run(
                    #[inline(always)]
                    || self.0.advance(memory, moment, terms, dt),
                );
            }
        }
    };
}
#[cfg(target_arch = "x86_64")]
law_with!(WithAvx512, with_avx512);
#[cfg(target_arch = "x86_64")]
law_with!(WithAvx2, with_avx2);
