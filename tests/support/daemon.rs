//! The live daemon as tests run it: a child process, a machine that sends it frames, and small clients of its sinks.

use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use serde_json::Value;

/// The program: this build's, or for measurements the one that SEEPD_BIN names.
fn program() -> PathBuf {
    std::env::var_os("SEEPD_BIN").map_or_else(|| env!("CARGO_BIN_EXE_seepd").into(), PathBuf::from)
}

/// Where a daemon of a folder logs to.
fn log_file(folder: &Path) -> fs::File {
    fs::OpenOptions::new().create(true).append(true).open(folder.join("daemon.log")).unwrap()
}

/// A running daemon; killed with its test.
pub(crate) struct Daemon {
    pub(crate) child: Child,
    pub(crate) log: PathBuf,
}

impl Daemon {
    /// Starts it in a folder with a configuration.
    pub(crate) fn start(folder: &Path, config: &str) -> Self {
        Self::start_with(folder, config, &[])
    }

    /// Starts it with more of an environment.
    pub(crate) fn start_with(folder: &Path, config: &str, environment: &[(&str, &str)]) -> Self {
        Self::spawn(folder, config, environment, Stdio::null(), log_file(folder).into())
    }

    /// Starts it with the allocator as its unit sets it: with a heap for each thread, each would keep what it has once needed.
    pub(crate) fn start_with_one_heap(folder: &Path, config: &str) -> Self {
        Self::start_with(folder, config, &[("MALLOC_ARENA_MAX", "1")])
    }

    /// Starts it with something else to log to than a file.
    pub(crate) fn start_logging_to(folder: &Path, config: &str, log: Stdio) -> Self {
        Self::spawn(folder, config, &[], Stdio::null(), log)
    }

    /// Starts it with a file as standard input.
    pub(crate) fn start_reading(folder: &Path, config: &str, input: &fs::File) -> Self {
        let input = Stdio::from(input.try_clone().unwrap());
        Self::spawn(folder, config, &[], input, log_file(folder).into())
    }

    fn spawn(folder: &Path, config: &str, environment: &[(&str, &str)], input: Stdio, log: Stdio) -> Self {
        let path = folder.join("seepd.toml");
        fs::write(&path, config).unwrap();
        let child = Command::new(program())
            .args(["run", "--config"])
            .arg(&path)
            .envs(environment.iter().copied())
            .stdin(input)
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .unwrap();
        Daemon { child, log: folder.join("daemon.log") }
    }

    /// What it has logged.
    pub(crate) fn words(&self) -> String {
        fs::read_to_string(&self.log).unwrap()
    }

    /// A value in kB of its memory, by the kernel's name.
    pub(crate) fn memory_kb(&self, name: &str) -> u64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':')).unwrap();
        line.trim().trim_end_matches(" kB").parse().unwrap()
    }

    /// Processor time that it has used, s.
    pub(crate) fn cpu_s(&self) -> f64 {
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap();
        let fields: Vec<f64> = stat
            .rsplit_once(')')
            .unwrap()
            .1
            .split_whitespace()
            .filter_map(|field| field.parse().ok())
            .collect();
        // State is no number: utime and stime are the 11th and 12th number behind it; ticks are 10 ms.
        (fields[10] + fields[11]) / 100.0
    }

    /// Sends a signal by name.
    pub(crate) fn signal(&self, name: &str) {
        let sent = Command::new("kill").args([&format!("-{name}"), &self.child.id().to_string()]).status();
        assert!(sent.unwrap().success());
    }

    /// Asks it to end, and tells how and how fast it did.
    pub(crate) fn terminate(mut self) -> (ExitStatus, Duration) {
        let begin = Instant::now();
        self.signal("TERM");
        (self.child.wait().unwrap(), begin.elapsed())
    }

    /// Waits for its own end.
    pub(crate) fn wait(mut self) -> ExitStatus {
        self.child.wait().unwrap()
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Waits until something holds, or fails with what it was. Patience ends after as many naps as the limit has: where the computer is busy
/// a nap takes longer than it was asked to, and so does what is waited for; after six times the limit it ends all the same.
pub(crate) fn until(what: &str, limit: Duration, mut holds: impl FnMut() -> bool) {
    const NAP: Duration = Duration::from_millis(20);
    let begin = Instant::now();
    let mut naps = limit.as_millis() / NAP.as_millis();
    while !holds() {
        let elapsed = begin.elapsed();
        assert!(naps > 0 && elapsed < 6 * limit, "not within {limit:?}, in {elapsed:?}: {what}");
        naps -= 1;
        thread::sleep(NAP);
    }
}

/// A port that is free now.
pub(crate) fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Whether a program is here; says so where it is not.
pub(crate) fn has(program: &str) -> bool {
    let here = Command::new("which")
        .arg(program)
        .stdout(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    if !here {
        let _ = writeln!(std::io::stderr(), "skipped: no {program} here");
    }
    here
}

/// An HTTP answer: its code, its head and its body.
pub(crate) struct Answer {
    pub(crate) code: u16,
    pub(crate) head: String,
    pub(crate) body: String,
}

impl Answer {
    /// The body as JSON.
    pub(crate) fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap_or_else(|error| panic!("{error}: {}", self.body))
    }
}

/// Asks over HTTP; `None` where nobody answers.
pub(crate) fn ask(port: u16, method: &str, path: &str, headers: &str) -> Option<Answer> {
    ask_with(port, method, path, headers, "")
}

/// The same with something to say.
pub(crate) fn ask_with(port: u16, method: &str, path: &str, headers: &str, said: &str) -> Option<Answer> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let host = if headers.contains("Host:") { String::new() } else { format!("Host: 127.0.0.1:{port}\r\n") };
    let request = format!(
        "{method} {path} HTTP/1.1\r\n{host}{headers}Connection: close\r\nContent-Length: {}\r\n\r\n{said}",
        said.len()
    );
    stream.write_all(request.as_bytes()).ok()?;
    let mut text = String::new();
    stream.read_to_string(&mut text).ok()?;
    let (head, body) = text.split_once("\r\n\r\n")?;
    let code = head.split(' ').nth(1)?.parse().ok()?;
    let body = if head.to_lowercase().contains("transfer-encoding: chunked") {
        unchunked(body)
    } else {
        body.to_owned()
    };
    Some(Answer { code, head: head.to_owned(), body })
}

fn unchunked(mut body: &str) -> String {
    let mut text = String::new();
    while let Some((size, rest)) = body.split_once("\r\n") {
        let Ok(size) = usize::from_str_radix(size, 16) else { break };
        if size == 0 {
            break;
        }
        text += &rest[..size];
        body = rest.get(size + 2..).unwrap_or_default();
    }
    text
}

/// Asks for JSON that must be there.
pub(crate) fn json(port: u16, path: &str) -> Value {
    let answer = ask(port, "GET", path, "").unwrap_or_else(|| panic!("nobody answers at {port}"));
    assert_eq!(answer.code, 200, "{path}: {}", answer.body);
    answer.json()
}

/// Status of the first axis, once the daemon answers.
pub(crate) fn axis_status(port: u16) -> Option<Value> {
    Some(ask(port, "GET", "/api/v1/status", "")?.json()["axes"][0].clone())
}

/// How the daemon says a sink is; null where there is none of the name.
pub(crate) fn sink(port: u16, name: &str) -> Value {
    let sinks = json(port, "/api/v1/status")["sinks"].clone();
    sinks.as_array().unwrap().iter().find(|sink| sink["name"] == name).cloned().unwrap_or_default()
}

/// A machine that sends its command a thousand times a second: 16 bits of 5e-5 and a counter, identifier 0x123.
pub(crate) struct Machine {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<u64>>,
}

/// The tables that read such a machine.
pub(crate) fn machine_toml(socket: &Path) -> String {
    format!(
        "[source]\ncan = \"unix:{}\"\ncounter = {{ bits = {{ id = 0x123, start = 16, length = 8 }} }}\n\
         [signals.command]\nbits = {{ id = 0x123, start = 0, length = 16, encoding = \"signed\" }}\nscale = 5e-5\n",
        socket.display()
    )
}

/// The same as one axis of several.
pub(crate) fn axis_toml(axis: &str, socket: &Path) -> String {
    let machine =
        machine_toml(socket).replace("[source]", "[axes.source]").replace("[signals", "[axes.signals");
    format!("[[axes]]\naxis = \"{axis}\"\n{machine}")
}

/// An axis of several that reads a log as fast as it can.
pub(crate) fn log_axis_toml(axis: &str, log: &Path) -> String {
    format!("[[axes]]\naxis = \"{axis}\"\n[axes.source]\nlog = \"{}\"\npace = \"fast\"\n", log.display())
}

/// A frame as Linux lays it out.
pub(crate) fn can_frame(id: u32, data: &[u8]) -> [u8; 16] {
    let mut frame = [0; 16];
    frame[..4].copy_from_slice(&id.to_ne_bytes());
    frame[4] = data.len() as u8;
    frame[8..8 + data.len()].copy_from_slice(data);
    frame
}

/// The machine's frame of a command.
pub(crate) fn command_frame(command: f64, counter: u8) -> [u8; 16] {
    let raw = (command / 5e-5).round() as i16;
    let [low, high] = raw.to_le_bytes();
    can_frame(0x123, &[low, high, counter])
}

/// One cycle's command of a fixture.
pub(crate) fn cycle(fixture: &str) -> Vec<f64> {
    let text = fs::read_to_string(super::support::fixture(fixture)).unwrap();
    text.lines().skip(1).map(|line| line.split(',').nth(1).unwrap().parse().unwrap()).collect()
}

impl Machine {
    /// Sends a cycle again and again.
    pub(crate) fn start(socket: &Path, command: Vec<f64>) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (stopped, socket) = (Arc::clone(&stop), socket.to_owned());
        let thread = thread::spawn(move || {
            let port = UnixDatagram::unbound().unwrap();
            until("the daemon's socket", Duration::from_secs(20), || port.connect(&socket).is_ok());
            // A busy daemon is waited for, as a bus's receive buffer would; a stopped one is not.
            port.set_write_timeout(Some(Duration::from_millis(300))).unwrap();
            let (begin, mut sent) = (Instant::now(), 0u64);
            while !stopped.load(Ordering::Relaxed) {
                while sent < begin.elapsed().as_millis() as u64 {
                    let value = command[sent as usize % command.len()];
                    // A daemon that was stopped takes nothing; the machine goes on.
                    let _ = port.send(&command_frame(value, sent as u8));
                    sent += 1;
                }
                thread::sleep(Duration::from_millis(1));
            }
            sent
        });
        Machine { stop, thread: Some(thread) }
    }

    /// Stops it, and tells how many frames it has sent.
    pub(crate) fn stop(mut self) -> u64 {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().map_or(0, |thread| thread.join().unwrap())
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// A mosquitto; killed with its test.
pub(crate) struct Mosquitto {
    child: Child,
    pub(crate) port: u16,
}

impl Mosquitto {
    /// Starts it on a port with more lines of configuration.
    pub(crate) fn start(folder: &Path, port: u16, more: &str) -> Self {
        let config = folder.join("mosquitto.conf");
        fs::write(&config, format!("listener {port} 127.0.0.1\nuser root\n{more}\n")).unwrap();
        let child = Command::new("mosquitto")
            .arg("-c")
            .arg(&config)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        until("mosquitto", Duration::from_secs(10), || TcpStream::connect(("127.0.0.1", port)).is_ok());
        Mosquitto { child, port }
    }

    /// Begins to write down what arrives, a line a message: topic and text.
    pub(crate) fn listen(&self, file: &Path, more: &[&str]) -> Listener {
        let out = fs::OpenOptions::new().create(true).append(true).open(file).unwrap();
        let child = Command::new("mosquitto_sub")
            .args(["-h", "localhost", "-p", &self.port.to_string(), "-v", "-q", "1", "-t", "seepd/#"])
            .args(more)
            .stdout(out)
            .spawn()
            .unwrap();
        // It has no way to tell that it listens; the retained messages come later in any case.
        thread::sleep(Duration::from_millis(300));
        Listener { child, file: file.to_owned() }
    }
}

impl Mosquitto {
    /// Ends it as a service manager does: what it has confirmed it keeps, where its configuration has it keep anything. One that is
    /// killed forgets what it has confirmed and not handed on yet.
    pub(crate) fn end(mut self) {
        assert!(Command::new("kill").arg(self.child.id().to_string()).status().unwrap().success());
        self.child.wait().unwrap();
    }
}

impl Drop for Mosquitto {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A script of tests/plant that takes part as another implementation would, and prints a line of JSON for all that it hears.
pub(crate) struct Companion {
    child: Child,
    file: PathBuf,
}

impl Companion {
    /// Starts it; what it prints goes to a file in the folder.
    pub(crate) fn start(mut python: Command, script: &str, folder: &Path, arguments: &[&str]) -> Self {
        let scripts = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/plant");
        let file = folder.join(format!("{script}.jsonl"));
        let child = python
            .arg(scripts.join(script))
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(fs::File::create(&file).unwrap())
            .spawn()
            .unwrap();
        Companion { child, file }
    }

    /// All that it has heard so far.
    pub(crate) fn heard(&self) -> Vec<Value> {
        let text = fs::read_to_string(&self.file).unwrap();
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        whole.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    /// Sends it a signal by name.
    pub(crate) fn signal(&self, name: &str) {
        let sent = Command::new("kill").args([&format!("-{name}"), &self.child.id().to_string()]).status();
        assert!(sent.unwrap().success());
    }

    /// Tells it to do something.
    pub(crate) fn say(&self, word: &str) {
        writeln!(self.child.stdin.as_ref().unwrap(), "{word}").unwrap();
    }
}

impl Drop for Companion {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A mosquitto_sub.
pub(crate) struct Listener {
    child: Child,
    file: PathBuf,
}

impl Listener {
    /// Messages so far under a topic.
    pub(crate) fn messages(&self, topic: &str) -> Vec<String> {
        let text = fs::read_to_string(&self.file).unwrap_or_default();
        let of_topic = |line: &str| line.strip_prefix(topic)?.strip_prefix(' ').map(str::to_owned);
        text.lines().filter_map(of_topic).collect()
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
