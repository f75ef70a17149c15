//! A CAN interface of the kernel's own, and what happens to it: taken down, deleted, made anew, another one under its name.
//!
//! Needs root and a kernel with vcan, as in the virtual machine of `tests/vm/faults`.

use std::os::fd::AsFd;
use std::os::unix::net::UnixDatagram;
use std::process::Command;

use socketcan::{CanSocket, Socket};

/// See the [module](self).
pub(super) struct Interface {
    name: String,
    port: Option<UnixDatagram>,
    /// How many have had the name before.
    retired: u32,
}

impl Interface {
    /// Makes it, up.
    pub(super) fn make(name: &str) -> Self {
        let interface = Interface { name: name.to_owned(), port: None, retired: 0 };
        interface.make_again();
        interface
    }

    /// Sends a frame as the kernel lays it out. One that the bus cannot take is lost, as any on a bus.
    pub(super) fn send(&mut self, frame: &[u8]) {
        if self.port.is_none() {
            // The socket of another kind is used for its way of sending, which is that of all of them.
            self.port = CanSocket::open(&self.name)
                .and_then(|socket| Ok(UnixDatagram::from(socket.as_fd().try_clone_to_owned()?)))
                .ok();
        }
        let is_gone = |error: &std::io::Error| error.raw_os_error() == Some(nix::libc::ENXIO);
        if self.port.as_ref().is_some_and(|port| port.send(frame).is_err_and(|error| is_gone(&error))) {
            self.port = None;
        }
    }

    pub(super) fn take_down(&self) {
        ip(&["link", "set", &self.name, "down"]);
    }

    pub(super) fn bring_up(&self) {
        ip(&["link", "set", &self.name, "up"]);
    }

    pub(super) fn delete(&mut self) {
        ip(&["link", "delete", &self.name]);
        self.port = None;
    }

    pub(super) fn make_again(&self) {
        ip(&["link", "add", &self.name, "type", "vcan"]);
        self.bring_up();
    }

    /// Gives it another name, under which it goes on.
    pub(super) fn rename(&mut self) {
        self.retired += 1;
        let other = format!("{}was{}", self.name, self.retired);
        self.take_down();
        ip(&["link", "set", &self.name, "name", &other]);
        ip(&["link", "set", &other, "up"]);
    }

    /// Makes another one under its name, and sends there from now on.
    pub(super) fn replace(&mut self) {
        self.make_again();
        self.port = None;
    }
}

fn ip(arguments: &[&str]) {
    let ended = Command::new("ip").args(arguments).status().unwrap();
    assert!(ended.success(), "ip {arguments:?}: {ended}");
}
