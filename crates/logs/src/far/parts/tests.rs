//! Against a server of HTTP that counts what it sends, and against moto's S3.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path as FilePath;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use seepd_signals::{Sample, Signal};

use super::*;
use crate::{LogError, LogMapping, logs_of};

const SHORT: Duration = Duration::from_millis(200);

/// How a server does its work.
#[derive(Clone, Copy, PartialEq)]
enum Manner {
    Good,
    /// It gives whole files alone.
    WithoutRanges,
    Denying,
    /// It says how long a file is, and no more.
    Silent,
    /// It closes the connection within each answer.
    Cutting,
    /// It gives whole files alone, and closes the connection within them.
    CuttingWhole,
    /// It has another file at each request.
    Replacing,
}

/// A server of one file under `/a.log`, on a port of its own.
struct Server {
    port: u16,
    sent: Arc<AtomicU64>,
}

impl Server {
    fn start(file: Vec<u8>, manner: Manner) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let sent = Arc::new(AtomicU64::new(0));
        let (file, count) = (Arc::new(file), sent.clone());
        thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                let (file, count) = (file.clone(), count.clone());
                thread::spawn(move || serve(&stream, &file, manner, &count));
            }
        });
        Server { port, sent }
    }

    fn address(&self) -> String {
        format!("http://127.0.0.1:{}/a.log", self.port)
    }
}

/// Answers the requests of a connection.
fn serve(stream: &TcpStream, file: &[u8], manner: Manner, sent: &AtomicU64) -> Option<()> {
    let mut lines = BufReader::new(stream).lines().map_while(Result::ok);
    let mut out = stream;
    for number in 0.. {
        let request = lines.next()?;
        let headers: Vec<String> = lines.by_ref().take_while(|line| !line.is_empty()).collect();
        let range = headers.iter().find_map(|line| {
            let range = line.to_lowercase().strip_prefix("range: bytes=")?.to_owned();
            let (from, to) = range.split_once('-')?;
            Some((from.parse::<usize>().ok()?, to.parse::<usize>().ok()?.min(file.len() - 1)))
        });
        let (status, (from, to)) = match (manner, range) {
            (Manner::Denying, _) => ("403 Forbidden", (0, 0)),
            _ if request.split(' ').nth(1)?.split('?').next()? != "/a.log" => ("404 Not Found", (0, 0)),
            (Manner::WithoutRanges | Manner::CuttingWhole, _) | (_, None) => ("200 OK", (0, file.len())),
            (_, Some((from, to))) => ("206 Partial Content", (from, to + 1)),
        };
        let is_head = request.starts_with("HEAD");
        if manner == Manner::Silent && !is_head {
            thread::sleep(Duration::from_secs(5));
            return None;
        }
        let version = if manner == Manner::Replacing { number } else { 0 };
        let mut head =
            format!("HTTP/1.1 {status}\r\nContent-Length: {}\r\nETag: \"{version}\"\r\n", to - from);
        if status.starts_with("206") {
            head += &format!("Content-Range: bytes {from}-{}/{}\r\n", to - 1, file.len());
        }
        out.write_all(format!("{head}\r\n").as_bytes()).ok()?;
        if is_head {
            continue;
        }
        let is_cutting = matches!(manner, Manner::Cutting | Manner::CuttingWhole);
        let to = if is_cutting { from + (to - from) / 2 } else { to };
        out.write_all(&file[from..to]).ok()?;
        sent.fetch_add((to - from) as u64, Ordering::Relaxed);
        if is_cutting {
            return None;
        }
    }
    None
}

/// Numbers that no compression makes small, of pictures beside a command.
fn noise(bytes: usize) -> Vec<u8> {
    let mut state = 1u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 56) as u8
    };
    (0..bytes).map(|_| next()).collect()
}

/// An MCAP log of so many chunks with pictures, 1 MB each, and one with commands after every tenth.
fn mcap_with_pictures(chunks: usize) -> Vec<u8> {
    let mut out = mcap::WriteOptions::new().create(std::io::Cursor::new(Vec::new())).unwrap();
    let none = BTreeMap::new();
    let pictures = out.add_channel(0, "/camera", "raw", &none).unwrap();
    let signals = out.add_channel(0, "/press/signals", "json", &none).unwrap();
    let picture = noise(1_000_000);
    let mut write = |channel_id, time_ms: usize, data: &[u8]| {
        let time = time_ms as u64 * 1_000_000;
        let header =
            mcap::records::MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        out.write_to_known_channel(&header, data).unwrap();
        if channel_id == pictures || time_ms % 1000 == 999 {
            out.flush().unwrap();
        }
    };
    for chunk in 0..chunks {
        write(pictures, chunk * 1000, &picture);
        let commands = if chunk % 10 == 9 { 1..1000 } else { 0..0 };
        for index in commands {
            let message = format!("{{\"command\":{}}}", index as f64 / 7e3);
            write(signals, chunk * 1000 + index, message.as_bytes());
        }
    }
    out.finish().unwrap();
    out.into_inner().into_inner()
}

fn samples(path: &FilePath) -> Result<Vec<Sample>, LogError> {
    let mut log = crate::open(path, &LogMapping::default())?;
    let mut samples = Vec::new();
    while let Some(sample) = log.next_sample()? {
        samples.push(sample);
    }
    assert_eq!(log.notes(), Vec::<String>::new());
    Ok(samples)
}

/// The same log as a file.
fn local(file: &[u8]) -> Vec<Sample> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.log");
    fs::write(&path, file).unwrap();
    samples(&path).unwrap()
}

#[test]
fn of_an_indexed_mcap_log_the_chunks_that_are_wanted_are_fetched() {
    let file = mcap_with_pictures(40);
    let server = Server::start(file.clone(), Manner::Good);
    let far = samples(FilePath::new(&server.address())).unwrap();
    assert_eq!((far.len(), &far), (4 * 999, &local(&file)));
    let (sent, bytes) = (server.sent.load(Ordering::Relaxed), file.len() as u64);
    assert!(bytes > 40_000_000 && sent < 12 * LEAST_PART, "{sent} of {bytes} bytes");
}

#[test]
fn other_logs_are_read_once_from_beginning_to_end() {
    let rows =
        (0..200_000).map(|index| format!("{},{}\n", f64::from(index) / 1e3, f64::from(index % 997) / 1e3));
    let file = format!("t_s,command\n{}", rows.collect::<String>()).into_bytes();
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(&file).unwrap();
    for log in [file.clone(), packed.finish().unwrap()] {
        let server = Server::start(log.clone(), Manner::Good);
        let far = samples(FilePath::new(&(server.address() + "?signature=secret"))).unwrap();
        assert_eq!(far.last().unwrap().get(Signal::Command), Some(0.599));
        assert_eq!(far, local(&file));
        assert_eq!(server.sent.load(Ordering::Relaxed), log.len() as u64);
    }
}

/// The answer to the first request, for a part, is the whole file too, as far as it is taken.
#[test]
fn a_server_that_gives_no_parts_is_asked_for_the_whole_log_once() {
    let file = mcap_with_pictures(10);
    let server = Server::start(file.clone(), Manner::WithoutRanges);
    assert_eq!(samples(FilePath::new(&server.address())).unwrap(), local(&file));
    let sent = server.sent.load(Ordering::Relaxed);
    assert!(sent <= 2 * file.len() as u64, "{sent} of {} bytes", file.len());
}

/// Ended with its test.
struct PythonsServer(Child);

impl Drop for PythonsServer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// `python3 -m http.server` gives no parts.
#[test]
fn reference_pythons_own_server_gives_the_samples_of_the_file() {
    let (folder, file) = (tempfile::tempdir().unwrap(), mcap_with_pictures(10));
    fs::write(folder.path().join("press 1.mcap"), &file).unwrap();
    let server = Command::new("python3")
        .args(["-u", "-m", "http.server", "0", "--bind", "127.0.0.1", "--directory"])
        .arg(folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn();
    let Ok(server) = server else {
        let _ = writeln!(io::stderr(), "left out: there is no python3");
        return;
    };
    let mut server = PythonsServer(server);
    let mut line = String::new();
    BufReader::new(server.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
    // Serving HTTP on 127.0.0.1 port 43121 (http://127.0.0.1:43121/) ...
    let port = line.split(' ').nth(5).unwrap();
    let far = samples(FilePath::new(&format!("http://127.0.0.1:{port}/press%201.mcap"))).unwrap();
    assert_eq!(far, local(&file));
}

/// Reads all there is.
fn read(address: &str) -> io::Result<usize> {
    Parts::open(address, SHORT)?.read_to_end(&mut Vec::new())
}

#[test]
fn what_fails_on_the_way_is_one_line_that_says_what_to_do() {
    let file = noise(1_000_000);
    let line = |manner, path: &str| {
        let server = Server::start(file.clone(), manner);
        let error =
            read(&format!("http://user:word@127.0.0.1:{}/{path}?key=secret", server.port)).unwrap_err();
        let text = error.to_string();
        assert!(!text.contains("secret") && !text.contains("word") && text.lines().count() == 1, "{text}");
        (error.kind(), text)
    };
    use io::ErrorKind;
    for (manner, path, kind, expected) in [
        (Manner::Good, "b.log", ErrorKind::NotFound, "there is no such object"),
        (Manner::Denying, "a.log", ErrorKind::PermissionDenied, "access is denied"),
        (Manner::Silent, "a.log", ErrorKind::TimedOut, "has not answered for 0.2 s"),
        (Manner::Cutting, "a.log", ErrorKind::UnexpectedEof, "answer is cut short"),
        (Manner::CuttingWhole, "a.log", ErrorKind::UnexpectedEof, "answer is cut short"),
        (Manner::Replacing, "a.log", ErrorKind::Other, "it was replaced while it was read"),
    ] {
        let (found, text) = line(manner, path);
        assert!(found == kind && text.contains(expected), "{found:?}: {text}");
    }
    let gone = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let text = read(&format!("http://{gone}/a.log")).unwrap_err().to_string();
    assert!(text.contains("Connection refused"), "{text}");
    assert!(read("https:///a.log").is_err() && read("s3://").is_err());
}

#[test]
fn a_log_may_be_read_within_another_runtime() {
    let server = Server::start(noise(1000), Manner::Good);
    let address = server.address();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    assert_eq!(runtime.block_on(async { read(&address) }).unwrap(), 1000);
}

/// moto's S3; ended with its test.
struct Moto(Child, u16);

impl Moto {
    /// Starts it with a bucket that has a file under several names; `None`, and a word, where it is not installed.
    fn start(file: &FilePath) -> Option<Self> {
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let put = format!(
            "
import boto3, sys, time
import moto.server
import threading
from werkzeug.serving import make_server
from moto.server import DomainDispatcherApplication, create_backend_app
server = make_server('127.0.0.1', {port}, DomainDispatcherApplication(create_backend_app), threaded=True)
threading.Thread(target=server.serve_forever, daemon=True).start()
s3 = boto3.client('s3', endpoint_url='http://127.0.0.1:{port}', region_name='us-east-1', aws_access_key_id='key', aws_secret_access_key='word')
s3.create_bucket(Bucket='plant')
for name in ['press.mcap', 'press_10.mcap', 'press_2.mcap', 'README.md', 'old/press_1.mcap']:
    s3.upload_file(sys.argv[1], 'plant', 'line 1/' + name)
print('ready', flush=True)
sys.stdin.read()
"
        );
        let mut child = Command::new("python3")
            .args(["-c", &put])
            .arg(file)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .ok()?;
        let mut word = String::new();
        BufReader::new(child.stdout.take()?).read_line(&mut word).ok()?;
        let moto = Moto(child, port);
        (word == "ready\n").then_some(moto)
    }
}

impl Drop for Moto {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// What the file of the next test is under its names; asked by that test in an environment of its own.
#[test]
#[ignore = "a part of the test of S3"]
fn in_the_environment_of_s3() {
    let far = samples(FilePath::new("s3://plant/line 1/press.mcap")).unwrap();
    assert_eq!(far, local(&mcap_with_pictures(10)));
    let gone = samples(FilePath::new("s3://plant/line 1/none.mcap")).unwrap_err();
    assert_eq!(gone.to_string(), "s3://plant/line 1/none.mcap: there is no such object");
    for (place, expected) in [
        ("s3://plant/line 1/", &["line 1/press.mcap", "line 1/press_2.mcap", "line 1/press_10.mcap"][..]),
        ("s3://plant/line 1/press_*.mcap", &["line 1/press_2.mcap", "line 1/press_10.mcap"]),
        ("s3://plant/*/press_?.mcap", &["line 1/press_2.mcap"]),
        ("s3://plant/l*/*/*", &["line 1/old/press_1.mcap"]),
        ("s3://plant/**/press_1*", &["line 1/old/press_1.mcap", "line 1/press_10.mcap"]),
    ] {
        let logs = logs_of(FilePath::new(place)).unwrap();
        let expected: Vec<String> = expected.iter().map(|key| format!("s3://plant/{key}")).collect();
        assert_eq!(logs, expected.iter().map(FilePath::new).collect::<Vec<_>>(), "{place}");
    }
    for (place, expected) in [
        ("s3://plant/line 2/", "there is no log of that name"),
        ("s3://plant/line 1/*.csv", "there is no log of that name"),
        ("s3://plant/[", "as a pattern"),
        ("s3://hall/", "the server says: The specified bucket does not exist"),
    ] {
        let refused = logs_of(FilePath::new(place)).unwrap_err().to_string();
        assert!(refused.starts_with(place) && refused.contains(expected), "{refused}");
    }
    // One machine's record: its clock goes on from log to log.
    let mut series =
        crate::open(FilePath::new("s3://plant/line 1/press_*.mcap"), &LogMapping::default()).unwrap();
    let mut times = Vec::new();
    while let Some(sample) = series.next_sample().unwrap() {
        times.push(sample.time_ns);
    }
    assert!(times.len() == 2 * far.len() && times.is_sorted(), "{}", times.len());
}

#[test]
fn reference_motos_s3_gives_the_samples_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("press.mcap");
    fs::write(&path, mcap_with_pictures(10)).unwrap();
    let Some(moto) = Moto::start(&path) else {
        let _ = writeln!(io::stderr(), "left out: moto is not installed (tools/requirements.txt)");
        return;
    };
    let run = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "far::parts::tests::in_the_environment_of_s3", "--ignored", "--nocapture"])
        .env("AWS_ENDPOINT_URL", format!("http://127.0.0.1:{}", moto.1))
        .env("AWS_ACCESS_KEY_ID", "key")
        .env("AWS_SECRET_ACCESS_KEY", "word")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&run.stdout) + String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success() && said.contains("1 passed"), "{said}");
}
