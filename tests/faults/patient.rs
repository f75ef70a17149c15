//! A machine that waits for room in the daemon's socket: each of its samples arrives, or the daemon has lost it. What they wait tells how
//! long the daemon was away from its socket, which holds ten of them.

use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crate::daemon::{command_frame, until};

/// See the [module](self).
pub(super) struct PatientMachine {
    stop: Arc<AtomicBool>,
    /// Since they were last taken, µs.
    waits_us: Arc<Mutex<Vec<u32>>>,
    thread: JoinHandle<u64>,
}

impl PatientMachine {
    /// Sends a cycle a thousand times a second, from so many samples behind its beginning.
    pub(super) fn start(socket: &Path, command: Vec<f64>, from: usize) -> Self {
        let (stop, waits_us) = (Arc::new(AtomicBool::new(false)), Arc::<Mutex<Vec<u32>>>::default());
        let (stopped, waits, socket) = (Arc::clone(&stop), Arc::clone(&waits_us), socket.to_owned());
        let thread = thread::spawn(move || {
            let port = UnixDatagram::unbound().unwrap();
            until("the daemon's socket", Duration::from_secs(20), || port.connect(&socket).is_ok());
            let (begin, mut sent) = (Instant::now(), 0_u64);
            while !stopped.load(Ordering::Relaxed) {
                while sent < begin.elapsed().as_millis() as u64 {
                    let value = command[(from + sent as usize) % command.len()];
                    let before = Instant::now();
                    port.send(&command_frame(value, sent as u8)).unwrap();
                    waits.lock().unwrap().push(before.elapsed().as_micros() as u32);
                    sent += 1;
                }
                thread::sleep(Duration::from_millis(1));
            }
            sent
        });
        PatientMachine { stop, waits_us, thread }
    }

    /// What its samples have waited since this was last asked, µs.
    pub(super) fn waits_us(&self) -> Vec<u32> {
        std::mem::take(&mut self.waits_us.lock().unwrap())
    }

    /// Stops it, and tells how many samples it has sent.
    pub(super) fn stop(self) -> u64 {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}
