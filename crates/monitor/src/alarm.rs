//! The alarm state machine: from estimates, cycle by cycle, to a flag.
//!
//! Several estimates in a row must agree before a flag rises, more before it falls, and it falls only below a
//! share of its threshold. Cycles without an estimate say nothing: they neither lengthen a row nor break it, or a lossy
//! input would hide the largest leak. No estimate is a state of its own, never silence and never zero; it does not end in
//! `healthy` while estimates lie above a threshold.

use serde::{Deserialize, Serialize};

use crate::event::{Evidence, Flag, Grounds};
use crate::reason::{NO_CYCLE_YET, UNCONFIRMED};

/// Thresholds and patience: the `[alarm]` table of `seepd.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlarmConfig {
    /// Flow from which a leak is watched, L/min at the reference pressure difference.
    pub watch_lpm: f64,
    /// Flow from which it is a leak, L/min; the article's limit of control.
    pub leak_lpm: f64,
    /// Flow from which it is severe, L/min.
    pub severe_lpm: f64,
    /// A flag falls below this share of its threshold.
    pub clear_share: f64,
    /// Estimates in a row at or above a threshold that raise a flag.
    pub raise_cycles: u32,
    /// Estimates in a row below a threshold's share that clear a flag.
    pub clear_cycles: u32,
    /// Rejected cycles in a row after which there is no estimate.
    pub lost_cycles: u32,
}

impl Default for AlarmConfig {
    fn default() -> Self {
        AlarmConfig {
            watch_lpm: 0.3,
            leak_lpm: 0.6,
            severe_lpm: 3.0,
            clear_share: 0.8,
            raise_cycles: 3,
            clear_cycles: 5,
            lost_cycles: 3,
        }
    }
}

impl AlarmConfig {
    /// Checks the values.
    ///
    /// # Errors
    /// [`AlarmConfigError`] that names the key.
    pub fn check(&self) -> Result<(), AlarmConfigError> {
        let ascending =
            0.0 < self.watch_lpm && self.watch_lpm < self.leak_lpm && self.leak_lpm < self.severe_lpm;
        if !ascending || !self.severe_lpm.is_finite() {
            return Err(AlarmConfigError::Thresholds);
        }
        if !(self.clear_share > 0.0 && self.clear_share <= 1.0) {
            return Err(AlarmConfigError::ClearShare(self.clear_share));
        }
        for (key, value) in [
            ("raise_cycles", self.raise_cycles),
            ("clear_cycles", self.clear_cycles),
            ("lost_cycles", self.lost_cycles),
        ] {
            if !(1..=100).contains(&value) {
                return Err(AlarmConfigError::Patience { key, value });
            }
        }
        Ok(())
    }

    fn threshold_lpm(&self, flag: Flag) -> f64 {
        match flag {
            Flag::NoEstimate | Flag::Healthy => 0.0,
            Flag::Watch => self.watch_lpm,
            Flag::Leak => self.leak_lpm,
            Flag::Severe => self.severe_lpm,
        }
    }
}

/// What is wrong with an alarm's configuration.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum AlarmConfigError {
    /// The thresholds are not in order.
    #[error("alarm: watch_lpm, leak_lpm and severe_lpm must be positive and ascend")]
    Thresholds,
    /// The share below which a flag clears is none.
    #[error("alarm.clear_share is {0}; it must lie in 0 … 1")]
    ClearShare(f64),
    /// A count of cycles is too small or too large.
    #[error("alarm.{key} is {value}; it must lie in 1 … 100")]
    Patience {
        /// Key.
        key: &'static str,
        /// Its value.
        value: u32,
    },
}

const RISING: [Flag; 3] = [Flag::Watch, Flag::Leak, Flag::Severe];

/// Estimates in a row that satisfy a condition, with the range of their flows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
struct Run {
    cycles: u32,
    lowest_lpm: f64,
    highest_lpm: f64,
}

impl Run {
    fn note(&mut self, agrees: bool, flow_lpm: f64) {
        if !agrees {
            *self = Run::default();
        } else if self.cycles == 0 {
            *self = Run { cycles: 1, lowest_lpm: flow_lpm, highest_lpm: flow_lpm };
        } else {
            self.cycles += 1;
            self.lowest_lpm = self.lowest_lpm.min(flow_lpm);
            self.highest_lpm = self.highest_lpm.max(flow_lpm);
        }
    }

    fn evidence(&self, grounds: Grounds, threshold_lpm: Option<f64>) -> Evidence {
        Evidence {
            grounds,
            cycles: self.cycles,
            lowest_lpm: Some(self.lowest_lpm),
            highest_lpm: Some(self.highest_lpm),
            threshold_lpm,
            reason: None,
        }
    }
}

/// A change of flag.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// Before.
    pub from: Flag,
    /// Now.
    pub to: Flag,
    /// On what grounds.
    pub evidence: Evidence,
}

/// The alarm's state.
#[derive(Debug, Clone, PartialEq)]
pub struct Alarm {
    /// The leak's level, kept while there is no estimate.
    level: Flag,
    reason: Option<&'static str>,
    highest: Flag,
    /// Estimates in a row at or above the threshold of watch, leak, severe.
    above: [Run; 3],
    /// Estimates in a row below the share of that threshold.
    below: [Run; 3],
    rejected: u32,
}

impl Default for Alarm {
    /// Nothing known yet.
    fn default() -> Self {
        Alarm {
            level: Flag::Healthy,
            reason: Some(NO_CYCLE_YET),
            highest: Flag::NoEstimate,
            above: [Run::default(); 3],
            below: [Run::default(); 3],
            rejected: 0,
        }
    }
}

/// What of an alarm outlives the program.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AlarmState {
    level: Flag,
    /// Whether there was an estimate.
    estimated: bool,
    highest: Flag,
    above: [Run; 3],
    below: [Run; 3],
    rejected: u32,
}

impl From<AlarmState> for Alarm {
    /// As it was; where there was no estimate, there is none until a cycle comes.
    fn from(state: AlarmState) -> Self {
        let AlarmState { level, estimated, highest, above, below, rejected } = state;
        let reason = (!estimated).then_some(NO_CYCLE_YET);
        Alarm { level: level.max(Flag::Healthy), reason, highest, above, below, rejected }
    }
}

impl From<&Alarm> for AlarmState {
    fn from(alarm: &Alarm) -> Self {
        let Alarm { level, reason, highest, above, below, rejected } = *alarm;
        AlarmState { level, estimated: reason.is_none(), highest, above, below, rejected }
    }
}

/// The highest flag since it was last acknowledged: a leak that comes and goes overnight is still told in the morning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Latch {
    /// The flag that is kept: watch, leak or severe.
    pub latched: Option<Flag>,
    /// Whether somebody has taken note of it.
    pub acknowledged: bool,
}

impl Latch {
    /// Takes the leak's level after a cycle.
    pub fn take(&mut self, level: Flag) {
        if level >= Flag::Watch && Some(level) > self.latched {
            *self = Latch { latched: Some(level), acknowledged: false };
        } else if self.acknowledged {
            self.latched = (level >= Flag::Watch).then_some(level);
            self.acknowledged = self.latched.is_some();
        }
    }

    /// Somebody has taken note; what has passed is forgotten. `false` where there was nothing to take note of.
    pub fn acknowledge(&mut self, level: Flag) -> bool {
        let news = self.latched.is_some() && !self.acknowledged;
        self.acknowledged = self.latched.is_some();
        self.take(level);
        news
    }
}

impl Alarm {
    /// The leak's level, kept while there is no estimate.
    pub fn level(&self) -> Flag {
        self.level
    }

    /// The flag now.
    pub fn flag(&self) -> Flag {
        if self.reason.is_some() { Flag::NoEstimate } else { self.level }
    }

    /// Why there is no estimate.
    pub fn reason(&self) -> Option<&'static str> {
        self.reason
    }

    /// The highest flag so far.
    pub fn highest(&self) -> Flag {
        self.highest
    }

    /// A cycle's estimate, as a flow at the reference pressure difference, L/min.
    pub fn estimated(&mut self, config: &AlarmConfig, flow_lpm: f64) -> Option<Change> {
        self.estimated_with(config, flow_lpm, false)
    }

    /// The same where the sums over cycles may have found a leak below the threshold, which is to be watched then.
    pub fn estimated_with(&mut self, config: &AlarmConfig, flow_lpm: f64, found: bool) -> Option<Change> {
        let from = self.flag();
        self.rejected = 0;
        for (index, flag) in RISING.into_iter().enumerate() {
            let threshold = config.threshold_lpm(flag);
            let found = found && flag == Flag::Watch;
            self.above[index].note(flow_lpm >= threshold || found, flow_lpm);
            self.below[index].note(flow_lpm < config.clear_share * threshold && !found, flow_lpm);
        }
        let evidence = self.raised(config).or_else(|| self.cleared(config));
        let is_unconfirmed = self.level == Flag::Healthy && self.above[0].cycles > 0;
        if is_unconfirmed && self.reason.is_some() {
            self.reason = Some(UNCONFIRMED);
            return None;
        }
        let regained = self.reason.take().is_some();
        self.highest = self.highest.max(self.level);
        let evidence = match evidence {
            Some(evidence) => evidence,
            None if regained => {
                let only = Run { cycles: 1, lowest_lpm: flow_lpm, highest_lpm: flow_lpm };
                only.evidence(Grounds::Estimate, None)
            }
            None => return None,
        };
        Some(Change { from, to: self.level, evidence })
    }

    /// A cycle's comparison on an axis without a model, where there is no size: the sums say whether something has changed.
    pub fn compared(&mut self, config: &AlarmConfig, has_changed: bool) -> Option<Change> {
        let change = self.estimated_with(config, 0.0, has_changed)?;
        let grounds = if change.to == Flag::Healthy { Grounds::AsAtBaseline } else { Grounds::Changed };
        let evidence =
            Evidence { grounds, lowest_lpm: None, highest_lpm: None, threshold_lpm: None, ..change.evidence };
        Some(Change { evidence, ..change })
    }

    fn raised(&mut self, config: &AlarmConfig) -> Option<Evidence> {
        let (index, flag) =
            RISING.into_iter().enumerate().rev().find(|(index, flag)| {
                *flag > self.level && self.above[*index].cycles >= config.raise_cycles
            })?;
        self.level = flag;
        let (run, threshold_lpm) = (&self.above[index], config.threshold_lpm(flag));
        // Estimates below the threshold are in the row where the sums have found a leak.
        Some(if run.lowest_lpm < threshold_lpm {
            run.evidence(Grounds::SumOverCycles, None)
        } else {
            run.evidence(Grounds::AboveThreshold, Some(threshold_lpm))
        })
    }

    fn cleared(&mut self, config: &AlarmConfig) -> Option<Evidence> {
        // Down to the lowest level whose next one has been clear for long enough.
        let (index, flag) = RISING
            .into_iter()
            .enumerate()
            .find(|(index, flag)| *flag <= self.level && self.below[*index].cycles >= config.clear_cycles)?;
        self.level = if index == 0 { Flag::Healthy } else { RISING[index - 1] };
        Some(self.below[index].evidence(Grounds::BelowThreshold, Some(config.threshold_lpm(flag))))
    }

    /// A cycle that could not be used.
    pub fn rejected(&mut self, config: &AlarmConfig, reason: &'static str) -> Option<Change> {
        self.rejected += 1;
        if self.rejected < config.lost_cycles {
            return None;
        }
        self.lost(reason)
    }

    /// The seal has been replaced: what was known of the leak is another seal's, and nothing is known of this one until a cycle comes.
    pub fn begin_anew(&mut self) -> Option<Change> {
        let change = self.lost(NO_CYCLE_YET);
        *self = Alarm { highest: self.highest, ..Alarm::default() };
        change
    }

    /// The input gives no estimates any more.
    pub fn lost(&mut self, reason: &'static str) -> Option<Change> {
        let from = self.flag();
        self.reason = Some(reason);
        let evidence = Evidence {
            grounds: Grounds::NoEstimate,
            cycles: self.rejected,
            lowest_lpm: None,
            highest_lpm: None,
            threshold_lpm: None,
            reason: Some(reason),
        };
        (from != Flag::NoEstimate).then_some(Change { from, to: Flag::NoEstimate, evidence })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(flows: &[f64]) -> (Alarm, Vec<(usize, Flag, Flag)>) {
        let config = AlarmConfig::default();
        let mut alarm = Alarm::default();
        let changes = flows
            .iter()
            .enumerate()
            .filter_map(|(index, flow)| {
                alarm.estimated(&config, *flow).map(|change| (index, change.from, change.to))
            })
            .collect();
        (alarm, changes)
    }

    #[test]
    fn a_new_seal_begins_without_a_flag_and_raises_its_own() {
        let config = AlarmConfig::default();
        let (mut alarm, _) = run(&[0.7, 0.7, 0.7]);
        let change = alarm.begin_anew().unwrap();
        assert_eq!((change.from, change.to, alarm.highest()), (Flag::Leak, Flag::NoEstimate, Flag::Leak));
        assert_eq!(alarm.begin_anew(), None);
        // The leak stands: it takes three cycles again, and until then it is not called healthy.
        let flags: Vec<Flag> = [0.7, 0.7, 0.7]
            .map(|flow| {
                alarm.estimated(&config, flow);
                alarm.flag()
            })
            .to_vec();
        assert_eq!(flags, [Flag::NoEstimate, Flag::NoEstimate, Flag::Leak]);
    }

    #[test]
    fn first_estimate_ends_the_ignorance() {
        assert_eq!(Alarm::default().flag(), Flag::NoEstimate);
        assert_eq!(run(&[0.05]).1, [(0, Flag::NoEstimate, Flag::Healthy)]);
    }

    #[test]
    fn two_outliers_raise_nothing_and_a_third_does() {
        let (_, changes) = run(&[0.1, 5.0, 5.0, 0.1, 0.7, 0.7, 0.7]);
        assert_eq!(changes[1..], [(6, Flag::Healthy, Flag::Leak)]);
    }

    #[test]
    fn flow_between_share_and_threshold_neither_raises_nor_clears() {
        let raised = [0.4, 0.4, 0.4];
        let hovering = [0.29, 0.25, 0.31, 0.27, 0.26, 0.29, 0.25];
        let (alarm, changes) = run(&[&raised[..], &hovering[..]].concat());
        assert_eq!(alarm.flag(), Flag::Watch);
        assert_eq!(changes, [(2, Flag::NoEstimate, Flag::Watch)]);
    }

    #[test]
    fn five_low_cycles_clear_to_the_level_that_fits() {
        let (alarm, changes) = run(&[4.0, 4.0, 4.0, 0.4, 0.4, 0.4, 0.4, 0.4]);
        assert_eq!(changes.last(), Some(&(7, Flag::Severe, Flag::Watch)));
        assert_eq!(alarm.highest(), Flag::Severe);
    }

    #[test]
    fn a_latch_keeps_what_came_and_went_until_it_is_acknowledged() {
        let mut latch = Latch::default();
        assert!(!latch.acknowledge(Flag::Healthy));
        latch.take(Flag::Leak);
        latch.take(Flag::Watch);
        latch.take(Flag::Healthy);
        assert_eq!(latch, Latch { latched: Some(Flag::Leak), acknowledged: false });
        assert!(latch.acknowledge(Flag::Healthy));
        assert_eq!(latch, Latch::default());
        latch.take(Flag::Leak);
        assert!(latch.acknowledge(Flag::Leak));
        assert!(!latch.acknowledge(Flag::Leak));
        assert_eq!(latch, Latch { latched: Some(Flag::Leak), acknowledged: true });
        latch.take(Flag::Severe);
        assert_eq!(latch, Latch { latched: Some(Flag::Severe), acknowledged: false });
        latch.acknowledge(Flag::Severe);
        latch.take(Flag::Watch);
        assert_eq!(latch, Latch { latched: Some(Flag::Watch), acknowledged: true });
        latch.take(Flag::Healthy);
        assert_eq!(latch, Latch::default());
    }

    #[test]
    fn an_alarm_comes_back_as_it_was() {
        let (alarm, _) = run(&[0.7, 0.7, 0.7, 5.0, 5.0]);
        let text = serde_json::to_string(&AlarmState::from(&alarm)).unwrap();
        let mut back = Alarm::from(serde_json::from_str::<AlarmState>(&text).unwrap());
        assert_eq!(back, alarm);
        let change = back.estimated(&AlarmConfig::default(), 5.0).unwrap();
        assert_eq!((change.from, change.to), (Flag::Leak, Flag::Severe));
    }

    #[test]
    fn without_a_model_a_change_is_watched_and_has_no_size() {
        let config = AlarmConfig::default();
        let mut alarm = Alarm::default();
        let told: Vec<(Flag, String)> = [false, true, true, true, false, false, false, false, false]
            .into_iter()
            .filter_map(|has_changed| alarm.compared(&config, has_changed))
            .map(|change| (change.to, change.evidence.to_string()))
            .collect();
        assert_eq!(
            told,
            [
                (Flag::Healthy, "1 cycle as at the baseline".to_owned()),
                (Flag::Watch, "the sums over cycles find a change since the baseline, 3 cycles".to_owned()),
                (Flag::Healthy, "5 cycles as at the baseline".to_owned()),
            ]
        );
    }

    #[test]
    fn loss_keeps_the_level_and_tells_the_reason() {
        let config = AlarmConfig::default();
        let (mut alarm, _) = run(&[0.7, 0.7, 0.7]);
        assert_eq!(alarm.rejected(&config, "gap"), None);
        assert_eq!(alarm.rejected(&config, "gap"), None);
        let change = alarm.rejected(&config, "gap").unwrap();
        assert_eq!(
            (change.from, change.to, change.evidence.reason),
            (Flag::Leak, Flag::NoEstimate, Some("gap"))
        );
        let change = alarm.estimated(&config, 0.7).unwrap();
        assert_eq!((change.from, change.to), (Flag::NoEstimate, Flag::Leak));
    }

    /// Two good cycles of five, whatever the rest's reason: the largest leak is told, and `healthy` never is.
    #[test]
    fn a_lossy_input_hides_no_leak() {
        let config = AlarmConfig::default();
        for pattern in ["GGLLL", "GLLLL", "LLGLL", "GLGLL", "G"] {
            let mut alarm = Alarm::default();
            let mut flags = Vec::new();
            for cycle in pattern.repeat(6).chars() {
                if cycle == 'G' {
                    alarm.estimated(&config, 53.0);
                } else {
                    alarm.rejected(&config, "gap");
                }
                flags.push(alarm.flag());
            }
            assert_eq!(alarm.highest(), Flag::Severe, "{pattern}");
            assert!(!flags.contains(&Flag::Healthy), "{pattern}: {flags:?}");
        }
    }

    #[test]
    fn an_estimate_above_a_threshold_does_not_end_ignorance_in_healthy() {
        let config = AlarmConfig::default();
        let mut alarm = Alarm::default();
        assert_eq!(alarm.estimated(&config, 0.4), None);
        assert_eq!((alarm.flag(), alarm.reason()), (Flag::NoEstimate, Some(UNCONFIRMED)));
        // One below the threshold does.
        let change = alarm.estimated(&config, 0.2).unwrap();
        assert_eq!((change.from, change.to), (Flag::NoEstimate, Flag::Healthy));
        // A known level stands while estimates come back.
        let (mut alarm, _) = run(&[0.4, 0.4, 0.4]);
        for _ in 0..3 {
            alarm.rejected(&config, "gap");
        }
        assert_eq!(alarm.estimated(&config, 53.0).unwrap().to, Flag::Watch);
    }

    #[test]
    fn a_flag_names_what_raised_it() {
        let config = AlarmConfig::default();
        let told = |flows: &[(f64, bool)]| {
            let mut alarm = Alarm::default();
            let changes =
                flows.iter().filter_map(|(flow, found)| alarm.estimated_with(&config, *flow, *found));
            changes.last().unwrap().evidence.to_string()
        };
        assert_eq!(
            told(&[(0.098, true), (0.11, true), (0.1, true)]),
            "the CUSUM finds more leakage than at the baseline, 3 cycles at 0.098 … 0.110 L/min"
        );
        assert_eq!(told(&[(0.4, false); 3]), "3 cycles at 0.400 … 0.400 L/min, threshold 0.3 L/min");
        // Above the threshold it is the threshold, whatever the sums say besides.
        assert_eq!(told(&[(0.4, true); 3]), "3 cycles at 0.400 … 0.400 L/min, threshold 0.3 L/min");
        assert_eq!(told(&[(0.1, false)]), "1 cycle at 0.100 L/min");
        let gone = [&[(0.4, false); 3][..], &[(0.1, false); 5]].concat();
        assert_eq!(told(&gone), "5 cycles at 0.100 … 0.100 L/min, below the threshold of 0.3 L/min");
    }
}
