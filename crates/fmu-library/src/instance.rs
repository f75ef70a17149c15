//! An instance as both versions of the standard see it: a pointer that tools hold, with calls that end in a status whatever happens.
#![expect(unsafe_code, reason = "a C interface is made of pointers that others hold and fill")]

use std::any::Any;
use std::error::Error;
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;

use seepd_fmu::{Kind, Simulation};

/// Statuses of both versions.
pub(crate) const OK: c_int = 0;
pub(crate) const ERROR: c_int = 3;
pub(crate) const FATAL: c_int = 4;

/// What went wrong, in words for the tool's log.
pub(crate) type Problem = Box<dyn Error>;

/// Logger of FMI 2, which is variadic.
pub(crate) type LoggerTwo =
    unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, ...);
/// Logger of FMI 3.
pub(crate) type LoggerThree = unsafe extern "C" fn(*mut c_void, c_int, *const c_char, *const c_char);

/// Where a tool wants to be told what went wrong.
#[derive(Clone)]
pub(crate) enum Log {
    /// Nowhere.
    Nowhere,
    /// Of FMI 2, with its environment and the instance's name.
    Two(LoggerTwo, *mut c_void, CString),
    /// Of FMI 3, with its environment.
    Three(LoggerThree, *mut c_void),
}

impl Log {
    pub(crate) fn tell(&self, status: c_int, message: &str) {
        let category = if status == FATAL { c"logStatusFatal" } else { c"logStatusError" };
        match self {
            Log::Nowhere => {}
            Log::Two(logger, environment, name) => {
                // The message is the format, so that loggers that cannot read further arguments show it too.
                let Ok(format) = CString::new(message.replace('%', "%%").replace('\0', " ")) else { return };
                // SAFETY: the tool gave this logger for calls of the standard's signature; texts live through the call.
                unsafe { logger(*environment, name.as_ptr(), status, category.as_ptr(), format.as_ptr()) }
            }
            Log::Three(logger, environment) => {
                let Ok(message) = CString::new(message.replace('\0', " ")) else { return };
                // SAFETY: as above.
                unsafe { logger(*environment, status, category.as_ptr(), message.as_ptr()) }
            }
        }
    }
}

/// A model that a tool has instantiated.
pub(crate) struct Instance {
    pub(crate) simulation: Simulation,
    /// Time at which the experiment begins, s.
    pub(crate) start_s: f64,
    log: Log,
}

/// What a tool says as it makes an instance.
pub(crate) struct Wanted {
    /// The token of the description that it has read.
    pub(crate) token: *const c_char,
    /// Folder of resources, as far as it has told one.
    pub(crate) resources: Option<PathBuf>,
    pub(crate) log: Log,
}

impl Instance {
    /// Makes an instance; null where that fails, which the log is told.
    pub(crate) fn made(wanted: Wanted) -> *mut Instance {
        let log = wanted.log.clone();
        match catch_unwind(AssertUnwindSafe(|| Instance::new(wanted))) {
            Ok(Ok(instance)) => Box::into_raw(Box::new(instance)),
            Ok(Err(problem)) => {
                log.tell(ERROR, &problem.to_string());
                std::ptr::null_mut()
            }
            Err(panic) => {
                log.tell(FATAL, &defect(panic.as_ref()));
                std::ptr::null_mut()
            }
        }
    }

    fn new(wanted: Wanted) -> Result<Self, Problem> {
        let folder =
            wanted.resources.ok_or("the tool named no folder of resources, in which the model is")?;
        let (simulation, expected) = Simulation::open(&folder)?;
        let token = text(wanted.token)?;
        if token != expected {
            return Err(format!("the token is {token}; that of the resources is {expected}").into());
        }
        Ok(Instance { simulation, start_s: 0.0, log: wanted.log })
    }

    /// Gets values of one kind.
    pub(crate) fn get<T>(
        &mut self,
        kind: Kind,
        (references, count): (*const u32, usize),
        to: *mut T,
        convert: impl Fn(f64) -> T,
    ) -> Result<(), Problem> {
        for (index, reference) in slice(references, count)?.iter().enumerate() {
            let value = self.simulation.get(kind, *reference)?;
            if to.is_null() {
                return Err("there is no place for values".into());
            }
            // SAFETY: the tool promises `count` places there; a place that was never written is only written.
            unsafe { to.add(index).write(convert(value)) };
        }
        Ok(())
    }

    /// Sets values of one kind.
    pub(crate) fn set<T: Copy>(
        &mut self,
        kind: Kind,
        (references, count): (*const u32, usize),
        from: *const T,
        convert: impl Fn(T) -> f64,
    ) -> Result<(), Problem> {
        for (reference, value) in slice(references, count)?.iter().zip(slice(from, count)?) {
            self.simulation.set(kind, *reference, convert(*value))?;
        }
        Ok(())
    }
}

/// Calls into an instance; a panic ends in Fatal, anything else that is wrong in Error, and both in the tool's log.
pub(crate) fn call(handle: *mut Instance, act: impl FnOnce(&mut Instance) -> Result<(), Problem>) -> c_int {
    // SAFETY: a tool hands back what it was given by `made`, or null, and calls one function of an instance at a time.
    let Some(instance) = (unsafe { handle.as_mut() }) else { return ERROR };
    match catch_unwind(AssertUnwindSafe(|| act(instance))) {
        Ok(Ok(())) => OK,
        Ok(Err(problem)) => {
            instance.log.tell(ERROR, &problem.to_string());
            ERROR
        }
        Err(panic) => {
            instance.log.tell(FATAL, &defect(panic.as_ref()));
            FATAL
        }
    }
}

fn defect(panic: &(dyn Any + Send)) -> String {
    let texts = (panic.downcast_ref::<String>(), panic.downcast_ref::<&str>());
    let text = texts.0.map(String::as_str).or(texts.1.copied()).unwrap_or("no reason given");
    format!("a defect of the model: {text}")
}

/// Frees what `made` gave.
pub(crate) fn free(handle: *mut Instance) {
    if !handle.is_null() {
        // SAFETY: the tool hands back what `made` gave, once.
        let instance = unsafe { Box::from_raw(handle) };
        let _ = catch_unwind(AssertUnwindSafe(|| drop(instance)));
    }
}

/// Keeps a state in the place that a tool has for one: a new one, or over one that is there.
pub(crate) fn keep_state(instance: &mut Instance, place: *mut *mut Simulation) -> Result<(), Problem> {
    let copy = instance.simulation.copied().ok_or("the model's state cannot be kept")?;
    // SAFETY: the tool's place holds null or what this function put there.
    unsafe {
        let place = place.as_mut().ok_or("there is no place for a state")?;
        match place.as_mut() {
            Some(there) => *there = copy,
            None => *place = Box::into_raw(Box::new(copy)),
        }
    }
    Ok(())
}

/// Takes up a kept state, which stays kept.
pub(crate) fn take_state(instance: &mut Instance, state: *const Simulation) -> Result<(), Problem> {
    // SAFETY: the tool hands back what `keep_state` put into its place.
    let kept = unsafe { state.as_ref() }.ok_or("there is no state")?;
    instance.simulation = kept.copied().ok_or("the model's state cannot be kept")?;
    Ok(())
}

/// Frees a kept state and empties its place.
pub(crate) fn free_state(place: *mut *mut Simulation) -> Result<(), Problem> {
    // SAFETY: the tool's place holds null or what `keep_state` put there.
    if let Some(place) = unsafe { place.as_mut() }
        && !place.is_null()
    {
        // SAFETY: as above; the place is emptied, so that it is freed once.
        drop(unsafe { Box::from_raw(*place) });
        *place = std::ptr::null_mut();
    }
    Ok(())
}

/// An array that a tool passes.
fn slice<'a, T>(from: *const T, count: usize) -> Result<&'a [T], Problem> {
    if count == 0 {
        return Ok(&[]);
    }
    if from.is_null() {
        return Err(format!("there is no array of {count} values").into());
    }
    // SAFETY: the tool promises that many values there, for as long as the call lasts.
    Ok(unsafe { std::slice::from_raw_parts(from, count) })
}

/// A text that a tool passes; empty for none.
pub(crate) fn text(from: *const c_char) -> Result<String, Problem> {
    if from.is_null() {
        return Ok(String::new());
    }
    // SAFETY: the tool promises a text that ends with a zero.
    Ok(unsafe { CStr::from_ptr(from) }.to_str()?.to_owned())
}
