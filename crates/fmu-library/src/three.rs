//! The functions of FMI 3.0, as its headers name them.
#![expect(unsafe_code, reason = "functions of a C interface, called by tools with pointers of theirs")]

use std::ffi::{c_char, c_int, c_void};
use std::path::PathBuf;

use seepd_fmu::{Kind, Simulation};

use crate::instance::{
    Instance, Log, LoggerThree, OK, Problem, Wanted, call, free, free_state, keep_state, take_state, text,
};

#[unsafe(no_mangle)]
extern "C" fn fmi3GetVersion() -> *const c_char {
    c"3.0".as_ptr()
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3InstantiateCoSimulation(
    _name: *const c_char,
    token: *const c_char,
    resources: *const c_char,
    _visible: bool,
    _logging: bool,
    _event_mode: bool,
    _early_return: bool,
    _intermediate: *const u32,
    _intermediate_count: usize,
    environment: *mut c_void,
    logger: Option<LoggerThree>,
    _intermediate_update: *const c_void,
) -> *mut Instance {
    let log = logger.map_or(Log::Nowhere, |logger| Log::Three(logger, environment));
    let resources = text(resources).ok().filter(|path| !path.is_empty()).map(PathBuf::from);
    Instance::made(Wanted { token, resources, log })
}

#[unsafe(no_mangle)]
extern "C" fn fmi3InstantiateModelExchange() -> *mut Instance {
    std::ptr::null_mut()
}

#[unsafe(no_mangle)]
extern "C" fn fmi3InstantiateScheduledExecution() -> *mut Instance {
    std::ptr::null_mut()
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3FreeInstance(handle: *mut Instance) {
    free(handle);
}

#[unsafe(no_mangle)]
extern "C" fn fmi3SetDebugLogging(_: *mut Instance, _: bool, _: usize, _: *const *const c_char) -> c_int {
    OK
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3EnterInitializationMode(
    handle: *mut Instance,
    _tolerance_defined: bool,
    _tolerance: f64,
    start_s: f64,
    _stop_defined: bool,
    _stop_s: f64,
) -> c_int {
    call(handle, |instance| Ok(instance.simulation.enter_initialisation(start_s)?))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3ExitInitializationMode(handle: *mut Instance) -> c_int {
    call(handle, |instance| Ok(instance.simulation.exit_initialisation()?))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3Terminate(handle: *mut Instance) -> c_int {
    call(handle, |_| Ok(()))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3Reset(handle: *mut Instance) -> c_int {
    call(handle, |instance| Ok(instance.simulation.reset()?))
}

/// There are no arrays: as many values as references.
fn one_each(references: usize, values: usize) -> Result<(), Problem> {
    if references == values {
        return Ok(());
    }
    Err(format!("{references} variables have {references} values, not {values}").into())
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3GetFloat64(
    handle: *mut Instance,
    references: *const u32,
    count: usize,
    values: *mut f64,
    value_count: usize,
) -> c_int {
    call(handle, |instance| {
        one_each(count, value_count)?;
        instance.get(Kind::Real, (references, count), values, |value| value)
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3SetFloat64(
    handle: *mut Instance,
    references: *const u32,
    count: usize,
    values: *const f64,
    value_count: usize,
) -> c_int {
    call(handle, |instance| {
        one_each(count, value_count)?;
        instance.set(Kind::Real, (references, count), values, |value| value)
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3GetBoolean(
    handle: *mut Instance,
    references: *const u32,
    count: usize,
    values: *mut bool,
    value_count: usize,
) -> c_int {
    call(handle, |instance| {
        one_each(count, value_count)?;
        instance.get(Kind::Boolean, (references, count), values, |value| value != 0.0)
    })
}

// A byte that is neither 0 nor 1 is no `bool`.
#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3SetBoolean(
    handle: *mut Instance,
    references: *const u32,
    count: usize,
    values: *const u8,
    value_count: usize,
) -> c_int {
    let number = |truth: u8| if truth == 0 { 0.0 } else { 1.0 };
    call(handle, |instance| {
        one_each(count, value_count)?;
        instance.set(Kind::Boolean, (references, count), values, number)
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3GetFMUState(handle: *mut Instance, place: *mut *mut Simulation) -> c_int {
    call(handle, |instance| keep_state(instance, place))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3SetFMUState(handle: *mut Instance, state: *mut Simulation) -> c_int {
    call(handle, |instance| take_state(instance, state))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3FreeFMUState(handle: *mut Instance, place: *mut *mut Simulation) -> c_int {
    call(handle, |_| free_state(place))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3DoStep(
    handle: *mut Instance,
    now_s: f64,
    step_s: f64,
    _no_return_before: bool,
    event_needed: *mut bool,
    terminate: *mut bool,
    early: *mut bool,
    reached_s: *mut f64,
) -> c_int {
    let mut end_s = now_s;
    let status = call(handle, |instance| {
        instance.simulation.step(step_s)?;
        end_s = now_s + step_s;
        Ok(())
    });
    for told in [event_needed, terminate, early] {
        // SAFETY: the tool's place, or null.
        if let Some(told) = unsafe { told.as_mut() } {
            *told = false;
        }
    }
    // SAFETY: as above.
    if let Some(reached_s) = unsafe { reached_s.as_mut() } {
        *reached_s = end_s;
    }
    status
}

/// Functions that every library has, and that mean nothing for these models: variables of other types, arrays, clocks, events, derivatives,
/// states as bytes, model exchange. Their further arguments are not looked at, which C's way of calling allows.
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
    fmi3GetFloat32 fmi3GetInt8 fmi3GetUInt8 fmi3GetInt16 fmi3GetUInt16 fmi3GetInt32 fmi3GetUInt32 fmi3GetInt64 fmi3GetUInt64
    fmi3GetString fmi3GetBinary fmi3GetClock
    fmi3SetFloat32 fmi3SetInt8 fmi3SetUInt8 fmi3SetInt16 fmi3SetUInt16 fmi3SetInt32 fmi3SetUInt32 fmi3SetInt64 fmi3SetUInt64
    fmi3SetString fmi3SetBinary fmi3SetClock
    fmi3GetNumberOfVariableDependencies fmi3GetVariableDependencies
    fmi3SerializedFMUStateSize fmi3SerializeFMUState fmi3DeserializeFMUState
    fmi3GetDirectionalDerivative fmi3GetAdjointDerivative fmi3GetOutputDerivatives
    fmi3EnterConfigurationMode fmi3ExitConfigurationMode fmi3EnterEventMode fmi3EnterStepMode
    fmi3GetIntervalDecimal fmi3GetIntervalFraction fmi3GetShiftDecimal fmi3GetShiftFraction
    fmi3SetIntervalDecimal fmi3SetIntervalFraction fmi3SetShiftDecimal fmi3SetShiftFraction
    fmi3EvaluateDiscreteStates fmi3UpdateDiscreteStates
    fmi3EnterContinuousTimeMode fmi3CompletedIntegratorStep fmi3SetTime fmi3SetContinuousStates
    fmi3GetContinuousStateDerivatives fmi3GetEventIndicators fmi3GetContinuousStates fmi3GetNominalsOfContinuousStates
    fmi3GetNumberOfEventIndicators fmi3GetNumberOfContinuousStates fmi3ActivateModelPartition
}
