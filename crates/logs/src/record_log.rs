//! Logs whose content is a row of records as MCAP has them: MCAP files themselves, and what is turned into such.

use std::io;

/// See the [module](self).
pub(crate) trait RecordLog {
    /// Puts the next record's content into `record` and gives its opcode; `None` at the end.
    ///
    /// # Errors
    /// Reading failed; damages are no error.
    fn next_record(&mut self, record: &mut Vec<u8>) -> io::Result<Option<u8>>;

    /// Hands the schemas and channels that stand in a summary, by opcode and content, to `take`.
    ///
    /// # Errors
    /// Reading failed.
    fn each_in_summary(&mut self, take: &mut dyn FnMut(u8, &[u8])) -> io::Result<()>;

    /// Whether [`only`](Self::only) would save reading.
    fn has_far_index(&self) -> bool {
        false
    }

    /// Passes over, from here on, what the log's own index says to have no message of these channels.
    ///
    /// # Errors
    /// Reading failed.
    fn only(&mut self, _is_wanted: &dyn Fn(u16) -> bool) -> io::Result<()> {
        Ok(())
    }

    /// What was damaged, one line each.
    fn notes(&self) -> Vec<String>;
}
