//! The functions of FMI 2.0, as its headers name them.
#![expect(unsafe_code, reason = "functions of a C interface, called by tools with pointers of theirs")]

use std::ffi::{CString, c_char, c_int, c_void};
use std::path::PathBuf;

use seepd_fmu::{Kind, Simulation};

use crate::instance::{
    ERROR, Instance, Log, LoggerTwo, OK, Wanted, call, free, free_state, keep_state, take_state, text,
};

/// What a tool gives for calls back. Its memory functions are not needed.
#[repr(C)]
struct Callbacks {
    logger: Option<LoggerTwo>,
    allocate: *const c_void,
    free: *const c_void,
    step_finished: *const c_void,
    environment: *mut c_void,
}

/// The kind of instance that this library makes.
const CO_SIMULATION: c_int = 1;

/// The folder that a `file:` URI names.
fn folder(uri: &str) -> Option<PathBuf> {
    let rest = uri.strip_prefix("file:")?;
    let path = match rest.strip_prefix("//") {
        // An authority, empty or `localhost`, before the path.
        Some(rest) => &rest[rest.find('/')?..],
        None => rest,
    };
    let mut bytes = Vec::with_capacity(path.len());
    let mut rest = path.as_bytes();
    while let Some((first, others)) = rest.split_first() {
        let code = (*first == b'%').then(|| others.get(..2)).flatten();
        let code = code.and_then(|hex| std::str::from_utf8(hex).ok());
        match code.and_then(|hex| u8::from_str_radix(hex, 16).ok()) {
            Some(byte) => {
                bytes.push(byte);
                rest = &others[2..];
            }
            None => {
                bytes.push(*first);
                rest = others;
            }
        }
    }
    let path = String::from_utf8(bytes).ok()?;
    // `/C:/…` of Windows.
    let is_drive = path.as_bytes().get(2) == Some(&b':');
    Some(PathBuf::from(if is_drive { path[1..].to_owned() } else { path }))
}

#[unsafe(no_mangle)]
extern "C" fn fmi2GetTypesPlatform() -> *const c_char {
    c"default".as_ptr()
}

#[unsafe(no_mangle)]
extern "C" fn fmi2GetVersion() -> *const c_char {
    c"2.0".as_ptr()
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2Instantiate(
    name: *const c_char,
    kind: c_int,
    token: *const c_char,
    resources: *const c_char,
    callbacks: *const Callbacks,
    _visible: c_int,
    _logging: c_int,
) -> *mut Instance {
    // SAFETY: the tool's callbacks, if it gives any, live as long as the instance.
    let callbacks = unsafe { callbacks.as_ref() };
    let name = text(name).ok().and_then(|name| CString::new(name).ok()).unwrap_or_default();
    let log = match callbacks.and_then(|callbacks| Some((callbacks.logger?, callbacks.environment))) {
        Some((logger, environment)) => Log::Two(logger, environment, name),
        None => Log::Nowhere,
    };
    if kind != CO_SIMULATION {
        log.tell(ERROR, "the model is for co-simulation alone");
        return std::ptr::null_mut();
    }
    let resources = text(resources).ok().and_then(|uri| folder(&uri));
    Instance::made(Wanted { token, resources, log })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2FreeInstance(handle: *mut Instance) {
    free(handle);
}

#[unsafe(no_mangle)]
extern "C" fn fmi2SetDebugLogging(_: *mut Instance, _: c_int, _: usize, _: *const *const c_char) -> c_int {
    OK
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetupExperiment(
    handle: *mut Instance,
    _tolerance_defined: c_int,
    _tolerance: f64,
    start_s: f64,
    _stop_defined: c_int,
    _stop_s: f64,
) -> c_int {
    call(handle, |instance| {
        instance.start_s = start_s;
        Ok(())
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2EnterInitializationMode(handle: *mut Instance) -> c_int {
    call(handle, |instance| Ok(instance.simulation.enter_initialisation(instance.start_s)?))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2ExitInitializationMode(handle: *mut Instance) -> c_int {
    call(handle, |instance| Ok(instance.simulation.exit_initialisation()?))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2Terminate(handle: *mut Instance) -> c_int {
    call(handle, |_| Ok(()))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2Reset(handle: *mut Instance) -> c_int {
    call(handle, |instance| Ok(instance.simulation.reset()?))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetReal(
    handle: *mut Instance,
    references: *const u32,
    count: usize,
    values: *mut f64,
) -> c_int {
    call(handle, |instance| instance.get(Kind::Real, (references, count), values, |value| value))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetReal(
    handle: *mut Instance,
    references: *const u32,
    count: usize,
    values: *const f64,
) -> c_int {
    call(handle, |instance| instance.set(Kind::Real, (references, count), values, |value| value))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetBoolean(
    handle: *mut Instance,
    references: *const u32,
    count: usize,
    values: *mut c_int,
) -> c_int {
    let truth = |value: f64| c_int::from(value != 0.0);
    call(handle, |instance| instance.get(Kind::Boolean, (references, count), values, truth))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetBoolean(
    handle: *mut Instance,
    references: *const u32,
    count: usize,
    values: *const c_int,
) -> c_int {
    let number = |truth: c_int| if truth == 0 { 0.0 } else { 1.0 };
    call(handle, |instance| instance.set(Kind::Boolean, (references, count), values, number))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetFMUstate(handle: *mut Instance, place: *mut *mut Simulation) -> c_int {
    call(handle, |instance| keep_state(instance, place))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetFMUstate(handle: *mut Instance, state: *mut Simulation) -> c_int {
    call(handle, |instance| take_state(instance, state))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2FreeFMUstate(handle: *mut Instance, place: *mut *mut Simulation) -> c_int {
    call(handle, |_| free_state(place))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2DoStep(
    handle: *mut Instance,
    _now_s: f64,
    step_s: f64,
    _no_return_before: c_int,
) -> c_int {
    call(handle, |instance| Ok(instance.simulation.step(step_s)?))
}

/// Functions that every library has, and that mean nothing for these models: variables of other types, derivatives, asynchronous steps,
/// states as bytes. Their further arguments are not looked at, which C's way of calling allows.
macro_rules! without_meaning {
    ($($name:ident)*) => {
        $(
            #[unsafe(no_mangle)]
            unsafe extern "C" fn $name(handle: *mut Instance) -> c_int {
                call(handle, |_| Err(concat!(stringify!($name), " means nothing for this model").into()))
            }
        )*
    };
}

without_meaning! {
    fmi2GetInteger fmi2SetInteger fmi2GetString fmi2SetString
    fmi2SerializedFMUstateSize fmi2SerializeFMUstate fmi2DeSerializeFMUstate fmi2GetDirectionalDerivative
    fmi2SetRealInputDerivatives fmi2GetRealOutputDerivatives fmi2CancelStep
    fmi2GetStatus fmi2GetRealStatus fmi2GetIntegerStatus fmi2GetBooleanStatus fmi2GetStringStatus
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uris_of_tools_name_the_folder() {
        let place = |uri: &str| folder(uri).map(|path| path.display().to_string());
        assert_eq!(place("file:///tmp/a%20b/resources").as_deref(), Some("/tmp/a b/resources"));
        assert_eq!(place("file:/tmp/resources").as_deref(), Some("/tmp/resources"));
        assert_eq!(place("file://localhost/tmp/resources").as_deref(), Some("/tmp/resources"));
        assert_eq!(place("file:///C:/fmu/resources").as_deref(), Some("C:/fmu/resources"));
        assert_eq!(place("file:///tmp/100%/r").as_deref(), Some("/tmp/100%/r"));
        assert_eq!(place("https://example.org/resources"), None);
        assert_eq!(place("file://"), None);
    }
}
