//! Where a command that reads logs finds the signals and the model.

use std::path::PathBuf;

use clap::Args;
use seepd_model::Model;

use crate::config::{Config, Selection, load_model};
use crate::failure::Failure;

/// The arguments that such commands share.
#[derive(Debug, Args)]
pub struct ReadingArguments {
    /// Configuration with mapping, model and alarm thresholds
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Model instead of the configuration's or the one that the program brings
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Topic of the signals, where the log has several axes; interface in a CAN log
    #[arg(long, value_name = "TOPIC")]
    topic: Option<String>,
    /// DBC file that describes a CAN log's frames
    #[arg(long, value_name = "FILE")]
    dbc: Option<PathBuf>,
    /// Field, column or DBC signal (`Signal` or `Message.Signal`) of the command
    #[arg(long, value_name = "FIELD")]
    command: Option<String>,
}

impl ReadingArguments {
    /// The configuration with what the command line says on top, and the model.
    ///
    /// # Errors
    /// [`Failure`] of either file.
    pub fn load(&self) -> Result<(Config, Model), Failure> {
        let mut config = self.config.as_deref().map_or_else(|| Ok(Config::default()), Config::read)?;
        config.selection = Selection { topic: self.topic.clone(), command: self.command.clone() };
        config.dbc = self.dbc.clone().or(config.dbc);
        let model = match &self.model {
            Some(path) => load_model(path)?,
            None => config.load_model()?,
        };
        Ok((config, model))
    }
}
