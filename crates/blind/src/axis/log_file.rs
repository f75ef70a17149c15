//! Logs as controllers and loggers write them: with units and names of their own, noise, and so many digits.

use std::fmt::Write;

use seepd_sim::noise::Noise;
use serde::{Deserialize, Serialize};

use super::draw::Choice;
use super::run::LogSample;

/// Periods from a row to the next that loggers offer, s.
const ROWS_S: [f64; 8] = [0.25e-3, 0.5e-3, 1e-3, 2e-3, 4e-3, 5e-3, 10e-3, 20e-3];

/// Which signals are logged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LoggedSignals {
    /// The valve command alone.
    Command,
    /// Command, position demand and position.
    Position,
}

/// How a log is written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LogFormat {
    /// Which signals it has.
    pub signals: LoggedSignals,
    /// The kind of file.
    pub container: Container,
    /// Its columns, or fields of its messages.
    pub style: Style,
    /// Ticks of the controller from a row to the next.
    pub nth: usize,
    /// Standard deviation of the command's noise, share of full command.
    pub command_noise: f64,
    /// Standard deviation of the position's noise, m.
    pub position_noise_m: f64,
}

/// The kind of a log file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Container {
    /// A table with the time in its first column.
    Csv,
    /// Messages in JSON, whose time is the container's.
    Mcap,
}

/// Names and units of the columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Style {
    /// SI units.
    Plain,
    /// %, mm and ms, units in brackets.
    Percent,
    /// V and mm, units behind the names.
    Volt,
    /// German names, semicolons.
    German,
}

/// Share of the machines whose logs are of MCAP.
const IN_MCAP: f64 = 0.15;
/// Styles of tables, as often as they are drawn, and of messages, whose fields have no blanks.
const STYLES: [Style; 6] =
    [Style::Plain, Style::Plain, Style::Plain, Style::Percent, Style::Volt, Style::German];
const FIELDS: [Style; 2] = [Style::Plain, Style::Volt];

/// Time, command, demand and position of a style: names, factor from SI, decimals.
type Columns = [(&'static str, f64, usize); 4];

impl Style {
    fn separator(self) -> &'static str {
        if self == Style::German { ";" } else { "," }
    }

    fn columns(self) -> Columns {
        match self {
            Style::Plain => [("t_s", 1.0, 5), ("command", 1.0, 5), ("demand", 1.0, 6), ("position", 1.0, 6)],
            Style::Percent => [
                ("Time [ms]", 1e3, 2),
                ("Valve command [%]", 1e2, 3),
                ("Set position [mm]", 1e3, 3),
                ("Actual position [mm]", 1e3, 3),
            ],
            Style::German => [
                ("Zeit [s]", 1.0, 5),
                ("Stellwert [%]", 1e2, 3),
                ("Sollposition [mm]", 1e3, 3),
                ("Istposition [mm]", 1e3, 3),
            ],
            Style::Volt => {
                [("time_s", 1.0, 5), ("valve_cmd_V", 10.0, 4), ("x_set_mm", 1e3, 3), ("x_act_mm", 1e3, 3)]
            }
        }
    }
}

impl LogFormat {
    /// Draws how a machine's logs of this period are written.
    pub(super) fn draw(
        signals: LoggedSignals,
        task_s: f64,
        period_s: f64,
        healthy_s: f64,
        noise: &mut Noise,
    ) -> Self {
        // A hundred rows a cycle and more, half a million a log and less.
        let (low, high) = ((100.0 / period_s).max(50.0), (5e5 / healthy_s).clamp(50.0, 4000.0));
        let wanted_s = 1.0 / noise.log_uniform(low, high.max(low));
        let nth = |row_s: f64| (row_s / task_s).round();
        // The longest usual period of rows that the task's fits into.
        let row_s = ROWS_S.iter().rev().find(|row_s| {
            **row_s <= wanted_s.max(task_s) * (1.0 + 1e-9)
                && (nth(**row_s) * task_s / **row_s - 1.0).abs() < 1e-9
        });
        let container = if noise.chance(IN_MCAP) { Container::Mcap } else { Container::Csv };
        LogFormat {
            signals,
            container,
            style: match container {
                Container::Csv => STYLES[noise.index(STYLES.len())],
                Container::Mcap => FIELDS[noise.index(FIELDS.len())],
            },
            nth: row_s.map_or(1, |row_s| nth(*row_s) as usize),
            command_noise: noise.log_uniform(1e-3, 5e-3),
            position_noise_m: noise.log_uniform(5e-6, 5e-5),
        }
    }

    /// The first line of a table.
    pub fn header(&self) -> String {
        let names: Vec<&str> = self.columns().map(|(name, ..)| name).collect();
        names.join(self.style.separator()) + "\n"
    }

    /// A sample as it is written: a line of a table, or a message.
    pub(super) fn text(&self, sample: LogSample, noise: &mut Noise, text: &mut String) {
        let command = sample.command + noise.normal(self.command_noise);
        let position_m = sample.position_m + noise.normal(self.position_noise_m);
        let values = [sample.time_s, command, sample.demand_m, position_m];
        let fields = self.columns().zip(values);
        let first = match self.container {
            Container::Csv => 0,
            Container::Mcap => 1,
        };
        for (index, ((name, factor, decimals), value)) in fields.enumerate().skip(first) {
            let value = value * factor;
            // A string takes whatever is written.
            let _ = match self.container {
                Container::Csv if index == 0 => write!(text, "{value:.decimals$}"),
                Container::Csv => write!(text, "{}{value:.decimals$}", self.style.separator()),
                Container::Mcap => {
                    let opening = if index == first { '{' } else { ',' };
                    write!(text, "{opening}\"{name}\":{value:.decimals$}")
                }
            };
        }
        text.push(match self.container {
            Container::Csv => '\n',
            Container::Mcap => '}',
        });
    }

    fn columns(&self) -> impl Iterator<Item = (&'static str, f64, usize)> {
        let count = match self.signals {
            LoggedSignals::Command => 2,
            LoggedSignals::Position => 4,
        };
        self.style.columns().into_iter().take(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(container: Container, style: Style) -> String {
        let signals = LoggedSignals::Position;
        let format =
            LogFormat { signals, container, style, nth: 1, command_noise: 0.0, position_noise_m: 0.0 };
        let sample = LogSample { time_s: 1.5, command: -0.25, demand_m: 0.125, position_m: 0.1237 };
        let mut text = String::new();
        format.text(sample, &mut Noise::new(1, 1), &mut text);
        text
    }

    #[test]
    fn samples_are_written_in_the_units_that_the_names_state() {
        assert_eq!(text(Container::Csv, Style::Plain), "1.50000,-0.25000,0.125000,0.123700\n");
        assert_eq!(text(Container::Csv, Style::Percent), "1500.00,-25.000,125.000,123.700\n");
        assert_eq!(text(Container::Csv, Style::German), "1.50000;-25.000;125.000;123.700\n");
        let message = r#"{"valve_cmd_V":-2.5000,"x_set_mm":125.000,"x_act_mm":123.700}"#;
        assert_eq!(text(Container::Mcap, Style::Volt), message);
    }
}
