//! The simulation of a training in portions, some of which may be done elsewhere.
//!
//! A training simulates some ten thousand machines that do not depend on each other, in portions of some hundred. A [`Share`] is every n-th
//! portion; what a share came to is a file, [`simulate_share`](crate::simulate_share) makes it, and [`train_with`](crate::train_with)
//! takes shares from wherever they were made. A portion that no share has is simulated there and then: a share that is lost costs time, and
//! never a model.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;

use seepd_features::statistics::CycleStatistics;
use seepd_sim::MachineSpec;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::train::{TrainError, TrainingSettings};

/// One of so many shares of a training's simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share {
    /// From 0.
    index: usize,
    of: NonZeroUsize,
}

impl Share {
    /// The share of a number in 1 … `of`; `None` for another.
    pub fn new(number: usize, of: usize) -> Option<Self> {
        let of = NonZeroUsize::new(of)?;
        (1..=of.get()).contains(&number).then(|| Share { index: number - 1, of })
    }

    fn has(self, place: usize) -> bool {
        place % self.of == self.index
    }
}

/// What simulated portions came to, by name.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Stored {
    /// Plant, settings and program of the training: portions of another one are refused.
    training: String,
    portions: BTreeMap<String, Vec<u8>>,
}

/// Portions that were simulated elsewhere; with none, everything is simulated here.
#[derive(Debug, Default)]
pub struct Portions {
    stored: Stored,
    /// Which are simulated here, where it is not those that are missing.
    own: Option<Share>,
    /// Portions that were asked for.
    place: usize,
}

impl Portions {
    /// Adds a share that [`simulate_share`](crate::simulate_share) made.
    ///
    /// # Errors
    /// [`TrainError::NotAShare`] for other bytes, [`TrainError::ForeignShare`] for a share of another training.
    pub fn add(
        &mut self,
        spec: &MachineSpec,
        settings: &TrainingSettings,
        share: &[u8],
    ) -> Result<(), TrainError> {
        let (content, digest) = share.split_last_chunk::<32>().ok_or(TrainError::NotAShare)?;
        if Sha256::digest(content).as_slice() != digest {
            return Err(TrainError::NotAShare);
        }
        let share: Stored = postcard::from_bytes(content).map_err(|_| TrainError::NotAShare)?;
        let training = training_of(spec, settings)?;
        if share.training != training {
            return Err(TrainError::ForeignShare);
        }
        self.stored.training = training;
        self.stored.portions.extend(share.portions);
        Ok(())
    }

    pub(crate) fn only(
        spec: &MachineSpec,
        settings: &TrainingSettings,
        share: Share,
    ) -> Result<Self, TrainError> {
        let stored = Stored { training: training_of(spec, settings)?, portions: BTreeMap::new() };
        Ok(Portions { stored, own: Some(share), place: 0 })
    }

    pub(crate) fn into_bytes(self) -> Result<Vec<u8>, TrainError> {
        let mut bytes = postcard::to_stdvec(&self.stored)?;
        let digest = Sha256::digest(&bytes);
        bytes.extend_from_slice(&digest);
        Ok(bytes)
    }

    /// What a portion came to: from a share, or from `simulate`; `None` where it is another share's to simulate.
    pub(crate) fn take<R: Serialize + DeserializeOwned>(
        &mut self,
        name: &str,
        simulate: impl FnOnce() -> R,
    ) -> Result<Option<R>, TrainError> {
        let place = self.place;
        self.place += 1;
        let Some(own) = self.own else {
            return Ok(Some(match self.stored.portions.remove(name) {
                Some(bytes) => postcard::from_bytes(&bytes)?,
                None => simulate(),
            }));
        };
        if !own.has(place) {
            return Ok(None);
        }
        let came_to = simulate();
        self.stored.portions.insert(name.to_owned(), postcard::to_stdvec(&came_to)?);
        Ok(Some(came_to))
    }
}

/// What portions depend on, as a hash.
fn training_of(spec: &MachineSpec, settings: &TrainingSettings) -> Result<String, TrainError> {
    let mut digest = Sha256::new();
    digest.update(env!("CARGO_PKG_VERSION"));
    digest.update(spec.to_toml()?);
    digest.update(format!("{settings:?}"));
    Ok(digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

/// A share of this training with these bytes as its portions, sealed as it should be.
#[cfg(fuzzing)]
pub fn sealed(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    portions: &[u8],
) -> Result<Vec<u8>, TrainError> {
    let content = [&postcard::to_stdvec(&training_of(spec, settings)?)?, portions].concat();
    Ok([&content[..], &Sha256::digest(&content)].concat())
}

/// Reads a portion of a share; whether it is one of cycles.
#[cfg(fuzzing)]
pub fn is_of_cycles(portion: &[u8]) -> bool {
    let rows = postcard::from_bytes::<Vec<Row>>(portion);
    rows.is_ok_and(|rows| rows.iter().all(|row| row.statistics().is_some()))
}

/// A cycle's statistics on their way between machines.
#[derive(Serialize, Deserialize)]
pub(crate) struct Row(Vec<f64>);

impl From<CycleStatistics> for Row {
    fn from(statistics: CycleStatistics) -> Self {
        let mut numbers = Vec::new();
        statistics.each_number(&mut |number| numbers.push(number));
        Row(numbers)
    }
}

impl Row {
    /// `None` for a row that was damaged on its way.
    pub(crate) fn statistics(&self) -> Option<CycleStatistics> {
        let mut numbers = self.0.iter();
        CycleStatistics::from_numbers(&mut || numbers.next().copied())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_numbered_from_one() {
        assert!(Share::new(0, 3).is_none() && Share::new(4, 3).is_none() && Share::new(1, 0).is_none());
        assert!(Share::new(3, 3).is_some());
    }

    #[test]
    fn each_portion_is_in_one_share() {
        let (spec, settings) = (MachineSpec::default(), TrainingSettings::default());
        let names = ["a", "b", "c", "d", "e"];
        let mut together = Portions::default();
        for number in 1..=2 {
            let mut portions = Portions::only(&spec, &settings, Share::new(number, 2).unwrap()).unwrap();
            for (value, name) in names.iter().enumerate() {
                portions.take(name, || vec![value as f64 / 3.0, f64::NAN]).unwrap();
            }
            together.add(&spec, &settings, &portions.into_bytes().unwrap()).unwrap();
        }
        for (value, name) in names.iter().enumerate() {
            let taken = together.take(name, Vec::<f64>::new).unwrap().unwrap();
            assert!(taken[0] == value as f64 / 3.0 && taken[1].is_nan());
        }
        assert_eq!(together.take("f", || 7).unwrap(), Some(7), "what no share has is simulated");
    }

    #[test]
    fn shares_of_another_training_are_refused() {
        let (spec, settings) = (MachineSpec::default(), TrainingSettings::default());
        let share =
            Portions::only(&spec, &settings, Share::new(1, 1).unwrap()).unwrap().into_bytes().unwrap();
        let other = TrainingSettings { seed: 2, ..settings.clone() };
        assert!(matches!(Portions::default().add(&spec, &other, &share), Err(TrainError::ForeignShare)));
        let mut damaged = share;
        damaged[3] ^= 1;
        assert!(matches!(Portions::default().add(&spec, &settings, &damaged), Err(TrainError::NotAShare)));
        assert!(matches!(Portions::default().add(&spec, &other, b"junk"), Err(TrainError::NotAShare)));
    }
}
