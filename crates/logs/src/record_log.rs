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

    /// What was damaged, one line each.
    fn notes(&self) -> Vec<String>;
}
