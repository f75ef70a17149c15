//! A child process that answers a line with a line, each in its time.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use thiserror::Error;

use crate::process_group;

/// Longest line that is taken from a child, bytes: a run of an hour at 1 kHz with seven signals.
const LONGEST_LINE: u64 = 512 << 20;
/// How much of what a child says on its standard error is kept, bytes.
const KEPT: usize = 2000;
/// How long a child that has closed its output may take to end.
const GRACE: Duration = Duration::from_millis(500);

/// Why a child did not answer.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ChildError {
    /// It could not be started.
    #[error("`{program}` cannot be started: {error}")]
    Start {
        /// The program.
        program: String,
        /// Why.
        error: std::io::Error,
    },
    /// It ended.
    #[error("the simulator ended ({how}){}", and_said(.said))]
    Ended {
        /// Exit status or signal, in words.
        how: String,
        /// The last lines of its standard error.
        said: String,
    },
    /// It did not answer in time.
    #[error("the simulator did not answer within {seconds:.1} s{}", and_said(.said))]
    Late {
        /// The time that it had, s.
        seconds: f64,
        /// The last lines of its standard error.
        said: String,
    },
}

fn and_said(text: &str) -> String {
    let last = text.lines().rev().find(|line| !line.trim().is_empty());
    last.map_or(String::new(), |line| format!("; it said: {}", line.trim()))
}

/// A running child. It is ended, with all that it has started in its process group, when this is dropped.
pub struct LineChild {
    child: Child,
    lines: Option<Sender<String>>,
    answers: Receiver<Option<String>>,
    said: Arc<Mutex<String>>,
}

impl LineChild {
    /// Starts a program in a folder, with environment variables beside those that there are.
    ///
    /// # Errors
    /// [`ChildError::Start`].
    pub fn start(
        command: &[String],
        folder: &Path,
        variables: &[(&str, String)],
    ) -> Result<Self, ChildError> {
        let (program, arguments) =
            command.split_first().map_or(("", [].as_slice()), |(p, a)| (p.as_str(), a));
        let mut command = Command::new(program);
        command
            .args(arguments)
            .current_dir(folder)
            .envs(variables.iter().map(|(name, value)| (*name, value)))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let started = process_group::lead(&mut command).spawn();
        let mut child = started.map_err(|error| ChildError::Start { program: program.to_owned(), error })?;
        let said = Arc::new(Mutex::new(String::new()));
        if let Some(errors) = child.stderr.take() {
            let said = Arc::clone(&said);
            thread::spawn(move || keep_last(errors, &said));
        }
        let (lines, to_write) = channel();
        if let Some(stdin) = child.stdin.take() {
            thread::spawn(move || write_lines(stdin, &to_write));
        }
        let (answered, answers) = channel();
        if let Some(stdout) = child.stdout.take() {
            thread::spawn(move || read_lines(stdout, &answered));
        }
        Ok(LineChild { child, lines: Some(lines), answers, said })
    }

    /// Sends a line and waits for one.
    ///
    /// # Errors
    /// [`ChildError`]; the child is of no use any more.
    pub fn ask(&mut self, line: String, time: Duration) -> Result<String, ChildError> {
        let sent = self.lines.as_ref().is_some_and(|lines| lines.send(line).is_ok());
        let answer = if sent { self.answers.recv_timeout(time) } else { Err(RecvTimeoutError::Disconnected) };
        match answer {
            Ok(Some(answer)) => Ok(answer),
            Err(RecvTimeoutError::Timeout) => {
                Err(ChildError::Late { seconds: time.as_secs_f64(), said: self.said() })
            }
            Ok(None) | Err(RecvTimeoutError::Disconnected) => {
                let how = self.ended();
                Err(ChildError::Ended { how, said: self.said() })
            }
        }
    }

    fn said(&self) -> String {
        self.said.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// How it ended, in words; it is made to where it has only closed its output.
    fn ended(&mut self) -> String {
        let parts = 20;
        for _ in 0..parts {
            if let Ok(Some(status)) = self.child.try_wait() {
                return process_group::how(status);
            }
            thread::sleep(GRACE / parts);
        }
        "it closed its output".to_owned()
    }
}

impl Drop for LineChild {
    fn drop(&mut self) {
        self.lines = None;
        process_group::end(&mut self.child);
    }
}

fn write_lines(mut stdin: ChildStdin, lines: &Receiver<String>) {
    for mut line in lines {
        line.push('\n'); // at once: a stepped plant is asked a million times
        if stdin.write_all(line.as_bytes()).and_then(|()| stdin.flush()).is_err() {
            return;
        }
    }
}

/// Lines as they come; the sender is dropped at the end, or at a line that has none.
fn read_lines(stdout: impl Read, answered: &Sender<Option<String>>) {
    let mut stdout = BufReader::new(stdout);
    loop {
        let mut line = Vec::new();
        let read = stdout.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line);
        let whole = read.is_ok() && line.last() == Some(&b'\n');
        let text = String::from_utf8_lossy(&line).trim().to_owned();
        if !whole || answered.send(Some(text)).is_err() {
            let _ = answered.send(None);
            return;
        }
    }
}

fn keep_last(errors: impl Read, said: &Mutex<String>) {
    let mut errors = BufReader::new(errors);
    loop {
        let mut line = Vec::new();
        match errors.by_ref().take(KEPT as u64).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        let mut said = said.lock().unwrap_or_else(PoisonError::into_inner);
        said.push_str(&String::from_utf8_lossy(&line));
        while said.len() > KEPT {
            let end = said.find('\n').map_or(said.len(), |end| end + 1);
            said.drain(..end);
        }
    }
}
