//! A model that runs: the FMU's library loaded, and its co-simulation functions called.
//!
//! This is foreign native code: it may crash, hang or print. Whoever loads one does so in a process that may die.
#![expect(
    unsafe_code,
    reason = "functions of a foreign library are called by the signatures that the standard gives them"
)]

use std::cell::RefCell;
use std::ffi::{CStr, CString, NulError, c_char, c_int, c_void};
use std::path::{Path, PathBuf};
use std::ptr::{null, null_mut};

use libloading::{Library, Symbol};
use thiserror::Error;

use crate::description::{ModelDescription, Version};

type Handle = *mut c_void;
/// A status as the library returns it: numbers that the standard does not know may come as well.
type Status = c_int;

/// Statuses up to here are no errors: OK and Warning.
const WARNING: Status = 1;

/// Why a model does not run.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum InstanceError {
    /// The library cannot be loaded.
    #[error("{file} cannot be loaded: {reason}")]
    Load {
        /// Its file.
        file: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// A function that every such FMU has.
    #[error("the FMU's library has no function {0}")]
    Function(&'static str),
    /// A text with a zero inside.
    #[error("a text for the FMU holds a zero: {0}")]
    Text(#[from] NulError),
    /// No instance.
    #[error("the FMU gives no instance: a wrong token, a missing resource, or a licence")]
    NoInstance,
    /// A function that returned an error.
    #[error("{function} returned {}{}{said}", status_name(*status), if said.is_empty() { "" } else { ": " })]
    Status {
        /// The function.
        function: &'static str,
        /// Its status.
        status: i32,
        /// What the model logged last in that call; of FMI 2 as it stands, without what it puts in for `%s` and the like.
        said: String,
    },
}

fn status_name(status: i32) -> String {
    match status {
        2 => "Discard".to_owned(),
        3 => "Error".to_owned(),
        4 => "Fatal".to_owned(),
        5 => "Pending".to_owned(),
        other => format!("the unknown status {other}"),
    }
}

/// What an FMI 2 model calls back. Only the format of a message is there to be told: its arguments would be variadic.
#[repr(C)]
struct CallbacksTwo {
    logger: extern "C" fn(Handle, *const c_char, Status, *const c_char, *const c_char),
    allocate: unsafe extern "C" fn(usize, usize) -> *mut c_void,
    free: unsafe extern "C" fn(*mut c_void),
    step_finished: *const c_void,
    environment: *mut c_void,
}

unsafe extern "C" {
    fn calloc(count: usize, size: usize) -> *mut c_void;
    fn free(block: *mut c_void);
}

extern "C" fn log_two(_: Handle, _: *const c_char, _: Status, _: *const c_char, message: *const c_char) {
    remember(message);
}

extern "C" fn log_three(_: Handle, _: Status, _: *const c_char, message: *const c_char) {
    remember(message);
}

/// Longest text of a model that is passed on, characters.
const MOST_SAID: usize = 300;

thread_local! {
    /// What a model logged last, for the error that may follow.
    static SAID: RefCell<String> = const { RefCell::new(String::new()) };
}

fn remember(message: *const c_char) {
    if message.is_null() {
        return;
    }
    // SAFETY: the standard has the model give a text that ends with a zero and lives through the call.
    let text = unsafe { CStr::from_ptr(message) }.to_string_lossy();
    let line = text.chars().map(|character| if character.is_control() { ' ' } else { character });
    SAID.with_borrow_mut(|said| *said = line.take(MOST_SAID).collect::<String>().trim().to_owned());
}

type Values = unsafe extern "C" fn(Handle, *const u32, usize, *mut f64) -> Status;
type ValuesThree = unsafe extern "C" fn(Handle, *const u32, usize, *mut f64, usize) -> Status;
type Plain = unsafe extern "C" fn(Handle) -> Status;
type Instantiate = unsafe extern "C" fn(
    *const c_char,
    c_int,
    *const c_char,
    *const c_char,
    *const CallbacksTwo,
    c_int,
    c_int,
) -> Handle;
type Setup = unsafe extern "C" fn(Handle, c_int, f64, f64, c_int, f64) -> Status;
type StepTwo = unsafe extern "C" fn(Handle, f64, f64, c_int) -> Status;
type InstantiateThree = unsafe extern "C" fn(
    *const c_char,
    *const c_char,
    *const c_char,
    bool,
    bool,
    bool,
    bool,
    *const u32,
    usize,
    *mut c_void,
    extern "C" fn(Handle, Status, *const c_char, *const c_char),
    *const c_void,
) -> Handle;
type EnterThree = unsafe extern "C" fn(Handle, bool, f64, f64, bool, f64) -> Status;
type StepThree =
    unsafe extern "C" fn(Handle, f64, f64, bool, *mut bool, *mut bool, *mut bool, *mut f64) -> Status;

/// Functions that are called over and over.
struct Functions {
    reset: Plain,
    exit_initialization: Plain,
    free: unsafe extern "C" fn(Handle),
    by_version: ByVersion,
}

enum ByVersion {
    Two { setup: Setup, enter: Plain, set: Values, get: Values, step: StepTwo },
    Three { enter: EnterThree, set: ValuesThree, get: ValuesThree, step: StepThree },
}

/// An instance of a model for co-simulation.
pub struct Instance {
    handle: Handle,
    functions: Functions,
    _callbacks: Option<Box<CallbacksTwo>>,
    // Dropped last: the functions are in it.
    _library: Library,
}

/// A function of the library.
fn function<T: Copy>(library: &Library, name: &'static str) -> Result<T, InstanceError> {
    let symbol = CString::new(name)?;
    // SAFETY: the standard gives a function of that name that signature; the library outlives every use (`Instance`).
    let found: Result<Symbol<'_, T>, _> = unsafe { library.get(symbol.as_bytes_with_nul()) };
    found.map(|symbol| *symbol).map_err(|_| InstanceError::Function(name))
}

fn good(function: &'static str, status: Status) -> Result<(), InstanceError> {
    let said = SAID.take();
    if (0..=WARNING).contains(&status) {
        Ok(())
    } else {
        Err(InstanceError::Status { function, status, said })
    }
}

impl Instance {
    /// Loads the library of an unpacked FMU and makes an instance.
    ///
    /// # Errors
    /// [`InstanceError`].
    ///
    /// # Safety
    /// Code of the library runs from here on, with all that this process may do, and nothing can check that its functions have the
    /// standard's signatures and keep to its rules. Call it in a process of its own that may die.
    pub unsafe fn new(
        folder: &Path,
        library: &Path,
        description: &ModelDescription,
    ) -> Result<Self, InstanceError> {
        // SAFETY: the caller's promise.
        let loaded = unsafe { Library::new(library) };
        let loaded = loaded.map_err(|error| InstanceError::Load {
            file: library.to_owned(),
            reason: std::error::Error::source(&error).map_or_else(|| error.to_string(), ToString::to_string),
        })?;
        match description.version {
            Version::Two => Self::of_two(loaded, folder, description),
            Version::Three => Self::of_three(loaded, folder, description),
        }
    }

    fn of_two(
        library: Library,
        folder: &Path,
        description: &ModelDescription,
    ) -> Result<Self, InstanceError> {
        let functions = Functions {
            reset: function(&library, "fmi2Reset")?,
            exit_initialization: function(&library, "fmi2ExitInitializationMode")?,
            free: function(&library, "fmi2FreeInstance")?,
            by_version: ByVersion::Two {
                setup: function(&library, "fmi2SetupExperiment")?,
                enter: function(&library, "fmi2EnterInitializationMode")?,
                set: function(&library, "fmi2SetReal")?,
                get: function(&library, "fmi2GetReal")?,
                step: function(&library, "fmi2DoStep")?,
            },
        };
        let instantiate: Instantiate = function(&library, "fmi2Instantiate")?;
        let callbacks = Box::new(CallbacksTwo {
            logger: log_two,
            allocate: calloc,
            free,
            step_finished: null(),
            environment: null_mut(),
        });
        let (name, token) =
            (CString::new(description.name.as_str())?, CString::new(description.token.as_str())?);
        let resources = CString::new(format!("file://{}/resources", folder.display()))?;
        // SAFETY: the signature is the standard's; texts and callbacks live as long as it asks (the latter as long as the instance).
        let handle = unsafe {
            instantiate(
                name.as_ptr(),
                CO_SIMULATION,
                token.as_ptr(),
                resources.as_ptr(),
                &raw const *callbacks,
                0,
                0,
            )
        };
        Self::made(handle, functions, Some(callbacks), library)
    }

    fn of_three(
        library: Library,
        folder: &Path,
        description: &ModelDescription,
    ) -> Result<Self, InstanceError> {
        let functions = Functions {
            reset: function(&library, "fmi3Reset")?,
            exit_initialization: function(&library, "fmi3ExitInitializationMode")?,
            free: function(&library, "fmi3FreeInstance")?,
            by_version: ByVersion::Three {
                enter: function(&library, "fmi3EnterInitializationMode")?,
                set: function(&library, "fmi3SetFloat64")?,
                get: function(&library, "fmi3GetFloat64")?,
                step: function(&library, "fmi3DoStep")?,
            },
        };
        let instantiate: InstantiateThree = function(&library, "fmi3InstantiateCoSimulation")?;
        let (name, token) =
            (CString::new(description.name.as_str())?, CString::new(description.token.as_str())?);
        let resources = CString::new(format!("{}/resources/", folder.display()))?;
        // SAFETY: the signature is the standard's; no event mode, no early return, no intermediate variables.
        let handle = unsafe {
            instantiate(
                name.as_ptr(),
                token.as_ptr(),
                resources.as_ptr(),
                false,
                false,
                false,
                false,
                null(),
                0,
                null_mut(),
                log_three,
                null(),
            )
        };
        Self::made(handle, functions, None, library)
    }

    fn made(
        handle: Handle,
        functions: Functions,
        callbacks: Option<Box<CallbacksTwo>>,
        library: Library,
    ) -> Result<Self, InstanceError> {
        if handle.is_null() {
            return Err(InstanceError::NoInstance);
        }
        Ok(Instance { handle, functions, _callbacks: callbacks, _library: library })
    }

    /// Back to where it was before it was initialised.
    ///
    /// # Errors
    /// [`InstanceError::Status`].
    pub fn reset(&mut self) -> Result<(), InstanceError> {
        // SAFETY: the instance lives.
        good("Reset", unsafe { (self.functions.reset)(self.handle) })
    }

    /// Sets values by their references; slices of unequal length end with the shorter one.
    ///
    /// # Errors
    /// [`InstanceError::Status`].
    pub fn set(&mut self, references: &[u32], values: &[f64]) -> Result<(), InstanceError> {
        let count = references.len().min(values.len());
        if count == 0 {
            return Ok(());
        }
        let (references, values) = (references.as_ptr(), values.as_ptr().cast_mut());
        // SAFETY: both point to `count` values; setters do not write.
        let status = unsafe {
            match &self.functions.by_version {
                ByVersion::Two { set, .. } => set(self.handle, references, count, values),
                ByVersion::Three { set, .. } => set(self.handle, references, count, values, count),
            }
        };
        good("setting values", status)
    }

    /// Reads values by their references; slices of unequal length end with the shorter one.
    ///
    /// # Errors
    /// [`InstanceError::Status`].
    pub fn get(&mut self, references: &[u32], values: &mut [f64]) -> Result<(), InstanceError> {
        let count = references.len().min(values.len());
        if count == 0 {
            return Ok(());
        }
        let (references, values) = (references.as_ptr(), values.as_mut_ptr());
        // SAFETY: both point to `count` values.
        let status = unsafe {
            match &self.functions.by_version {
                ByVersion::Two { get, .. } => get(self.handle, references, count, values),
                ByVersion::Three { get, .. } => get(self.handle, references, count, values, count),
            }
        };
        good("reading values", status)
    }

    /// Begins its initialisation at time 0; what is set before it are parameters.
    ///
    /// # Errors
    /// [`InstanceError::Status`].
    pub fn enter_initialization(&mut self) -> Result<(), InstanceError> {
        // SAFETY: the instance lives.
        match &self.functions.by_version {
            ByVersion::Two { setup, enter, .. } => unsafe {
                good("fmi2SetupExperiment", setup(self.handle, 0, 0.0, 0.0, 0, 0.0))?;
                good("fmi2EnterInitializationMode", enter(self.handle))
            },
            ByVersion::Three { enter, .. } => unsafe {
                good("fmi3EnterInitializationMode", enter(self.handle, false, 0.0, 0.0, false, 0.0))
            },
        }
    }

    /// Ends its initialisation.
    ///
    /// # Errors
    /// [`InstanceError::Status`].
    pub fn exit_initialization(&mut self) -> Result<(), InstanceError> {
        // SAFETY: the instance lives.
        good("ExitInitializationMode", unsafe { (self.functions.exit_initialization)(self.handle) })
    }

    /// One communication step from a time, s.
    ///
    /// # Errors
    /// [`InstanceError::Status`].
    pub fn step(&mut self, at_s: f64, step_s: f64) -> Result<(), InstanceError> {
        let (mut event, mut end, mut early, mut reached) = (false, false, false, 0.0);
        // SAFETY: the instance lives, and the places for answers too.
        let status = unsafe {
            match &self.functions.by_version {
                ByVersion::Two { step, .. } => step(self.handle, at_s, step_s, 1),
                ByVersion::Three { step, .. } => step(
                    self.handle,
                    at_s,
                    step_s,
                    true,
                    &raw mut event,
                    &raw mut end,
                    &raw mut early,
                    &raw mut reached,
                ),
            }
        };
        good("DoStep", status)
    }
}

/// The kind of instance in FMI 2.
const CO_SIMULATION: c_int = 1;

impl Drop for Instance {
    fn drop(&mut self) {
        // SAFETY: the instance lives, and nobody has it after this.
        unsafe { (self.functions.free)(self.handle) }
    }
}
