//! A child with all that it starts: one group, which ends together.

use std::process::{Child, Command, ExitStatus};

/// Makes a command's child the head of a group of its own.
#[cfg(unix)]
pub(crate) fn lead(command: &mut Command) -> &mut Command {
    std::os::unix::process::CommandExt::process_group(command, 0)
}

/// Windows knows no such groups: what a child has started outlives it there.
#[cfg(not(unix))]
pub(crate) fn lead(command: &mut Command) -> &mut Command {
    command
}

/// Ends a child with its group, and waits for the child.
pub(crate) fn end(child: &mut Child) {
    #[cfg(unix)]
    if let Ok(group) = i32::try_from(child.id()) {
        use nix::sys::signal::{Signal, killpg};
        // One that has ended by itself may have left others in its group.
        let _ = killpg(nix::unistd::Pid::from_raw(group), Signal::SIGKILL);
    }
    #[cfg(not(unix))]
    let _ = child.kill();
    let _ = child.wait();
}

/// How a child ended, in words.
pub(crate) fn how(status: ExitStatus) -> String {
    let code = status.code().map(|code| format!("exit status {code}"));
    code.or_else(|| by_signal(status)).unwrap_or_else(|| "for no known reason".to_owned())
}

#[cfg(unix)]
fn by_signal(status: ExitStatus) -> Option<String> {
    let signal = std::os::unix::process::ExitStatusExt::signal(&status)?;
    let name = nix::sys::signal::Signal::try_from(signal);
    Some(name.map_or_else(|_| format!("signal {signal}"), |name| name.to_string()))
}

#[cfg(not(unix))]
fn by_signal(_: ExitStatus) -> Option<String> {
    None
}
