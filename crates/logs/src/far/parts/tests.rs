//! Against a server of HTTP that counts what it sends, and against moto's S3.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path as FilePath;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};

use seepd_signals::{Sample, Signal};

use super::*;
use crate::{LogError, LogMapping};

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
            (Manner::WithoutRanges, _) | (_, None) => ("200 OK", (0, file.len())),
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
        let to = if manner == Manner::Cutting { from + (to - from) / 2 } else { to };
        out.write_all(&file[from..to]).ok()?;
        sent.fetch_add((to - from) as u64, Ordering::Relaxed);
        if manner == Manner::Cutting {
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
        (
            Manner::WithoutRanges,
            "a.log",
            ErrorKind::Unsupported,
            "gives no parts of a file (HTTP ranges); download",
        ),
        (Manner::Silent, "a.log", ErrorKind::TimedOut, "has not answered for 0.2 s"),
        (Manner::Cutting, "a.log", ErrorKind::UnexpectedEof, "answer is cut short"),
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
    /// Starts it with a bucket that has a file; `None`, and a word, where it is not installed.
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
s3.upload_file(sys.argv[1], 'plant', 'line 1/press.mcap')
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

/// Where the file of the next test lies, and how many samples it has; asked of by that test in an environment of its own.
#[test]
#[ignore = "a part of the test of S3"]
fn in_the_environment_of_s3() {
    let far = samples(FilePath::new("s3://plant/line 1/press.mcap")).unwrap();
    assert_eq!(far, local(&mcap_with_pictures(10)));
    let gone = samples(FilePath::new("s3://plant/line 1/none.mcap")).unwrap_err();
    assert_eq!(gone.to_string(), "s3://plant/line 1/none.mcap: there is no such object");
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
