//! NVIDIA's run-time compiler and driver, found when they are needed, and the kernels that they
//! make.

#![expect(unsafe_code, reason = "both are libraries of C")]

use std::ffi::{CStr, CString, c_char, c_int, c_uint, c_void};
use std::ptr;

use tch::TchError;

/// What a kernel is given: pointers to tensors' memory, and numbers.
#[derive(Clone, Copy, Debug)]
pub(super) enum Argument {
    Memory(*mut c_void),
    Number(c_int),
}

/// Libraries that stay loaded. The first has the compiler and the driver among those that it needs.
const NAMES: [&CStr; 4] = [
    c"libcaffe2_nvrtc.so",
    c"libnvrtc.so.13",
    c"libnvrtc.so.12",
    c"libcuda.so.1",
];

/// `CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR` and `_MINOR`.
const CAPABILITY: [c_int; 2] = [75, 76];

macro_rules! functions {
    ($($name:ident: $symbol:literal ($($argument:ty),*)),* $(,)?) => {
        /// The functions, by the types of `nvrtc.h` and `cuda.h`.
        #[derive(Clone, Copy, Debug)]
        struct Functions {
            $($name: unsafe extern "C" fn($($argument),*) -> c_int,)*
        }

        impl Functions {
            fn of(libraries: &[*mut c_void]) -> Option<Self> {
                Some(Self {
                    // SAFETY: the types are those of the headers.
                    $($name: unsafe { function(libraries, $symbol) }?,)*
                })
            }
        }
    };
}

functions! {
    create: c"nvrtcCreateProgram" (*mut *mut c_void, *const c_char, *const c_char, c_int, *const *const c_char, *const *const c_char),
    destroy: c"nvrtcDestroyProgram" (*mut *mut c_void),
    compile: c"nvrtcCompileProgram" (*mut c_void, c_int, *const *const c_char),
    log_size: c"nvrtcGetProgramLogSize" (*mut c_void, *mut usize),
    log: c"nvrtcGetProgramLog" (*mut c_void, *mut c_char),
    code_size: c"nvrtcGetCUBINSize" (*mut c_void, *mut usize),
    code: c"nvrtcGetCUBIN" (*mut c_void, *mut c_char),
    device: c"cuCtxGetDevice" (*mut c_int),
    attribute: c"cuDeviceGetAttribute" (*mut c_int, c_int, c_int),
    load: c"cuModuleLoadData" (*mut *mut c_void, *const c_void),
    kernel: c"cuModuleGetFunction" (*mut *mut c_void, *mut c_void, *const c_char),
    launch: c"cuLaunchKernel" (
        *mut c_void, c_uint, c_uint, c_uint, c_uint, c_uint, c_uint, c_uint, *mut c_void, *mut *mut c_void, *mut *mut c_void
    ),
}

/// The function called `name`, of the first library that has it.
///
/// # Safety
/// `F` must be the type of a pointer to that function.
unsafe fn function<F: Copy>(libraries: &[*mut c_void], name: &CStr) -> Option<F> {
    const { assert!(size_of::<F>() == size_of::<*mut c_void>()) };
    let found = libraries.iter().find_map(|&library| {
        // SAFETY: the library stays loaded, and the name is a C string.
        let found = unsafe { libc::dlsym(library, name.as_ptr()) };
        (!found.is_null()).then_some(found)
    })?;
    // SAFETY: both are pointers of one size, and the caller vouches for the type.
    Some(unsafe { std::mem::transmute_copy(&found) })
}

fn checked(what: &str, code: c_int) -> Result<(), TchError> {
    if code == 0 {
        return Ok(());
    }
    Err(TchError::Torch(format!("{what} failed with code {code}")))
}

/// Kernels of the thread's current CUDA device. They stay with it as long as the process lives,
/// since captured graphs refer to them.
#[derive(Debug)]
pub(super) struct Library {
    /// Each from the first library that has it.
    functions: Functions,
    /// The compiled code, loaded in the device's context.
    module: *mut c_void,
}

/// A kernel of a library.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kernel(*mut c_void);

impl Library {
    /// Compiles `source` for the device; its context must be there.
    pub(super) fn compiled(source: &str) -> Result<Self, TchError> {
        let missing = || TchError::Torch("no run-time compiler (NVRTC) or driver".to_owned());
        let libraries: Vec<*mut c_void> = NAMES
            .iter()
            // SAFETY: the names are C strings.
            .map(|name| unsafe { libc::dlopen(name.as_ptr(), libc::RTLD_NOW | libc::RTLD_GLOBAL) })
            .filter(|library| !library.is_null())
            .collect();
        let functions = Functions::of(&libraries).ok_or_else(missing)?;
        let code = functions.code_of(source)?;
        let mut module = ptr::null_mut();
        // SAFETY: the code is whole, and the module a variable of ours.
        let failed = unsafe { (functions.load)(&raw mut module, code.as_ptr().cast()) };
        checked("cuModuleLoadData", failed)?;
        Ok(Self { functions, module })
    }

    /// The function `name` of the source, which must be `extern "C"` there.
    pub(super) fn kernel(&self, name: &CStr) -> Result<Kernel, TchError> {
        let mut kernel = ptr::null_mut();
        // SAFETY: the module is loaded, the name a C string, and the kernel a variable of ours.
        let failed =
            unsafe { (self.functions.kernel)(&raw mut kernel, self.module, name.as_ptr()) };
        checked("cuModuleGetFunction", failed)?;
        Ok(Kernel(kernel))
    }

    /// Launches `kernel` on `stream`, in `blocks` (x, y) of so many `threads`.
    ///
    /// # Safety
    /// The arguments must be those of the kernel, and their memory large enough for it.
    pub(super) unsafe fn launch(
        &self,
        kernel: Kernel,
        blocks: [c_uint; 2],
        threads: c_uint,
        stream: *mut c_void,
        arguments: &mut [Argument],
    ) -> Result<(), TchError> {
        let mut places: Vec<*mut c_void> = arguments
            .iter_mut()
            .map(|argument| match argument {
                Argument::Memory(memory) => ptr::from_mut(memory).cast(),
                Argument::Number(number) => ptr::from_mut(number).cast(),
            })
            .collect();
        let [x, y] = blocks;
        let (places, none) = (places.as_mut_ptr(), ptr::null_mut());
        // SAFETY: the kernel is this module's; the caller vouches for the arguments.
        let failed = unsafe {
            (self.functions.launch)(kernel.0, x, y, 1, threads, 1, 1, 0, stream, places, none)
        };
        checked("cuLaunchKernel", failed)
    }
}

impl Functions {
    /// Machine code of `source` for the thread's current device.
    fn code_of(self, source: &str) -> Result<Vec<c_char>, TchError> {
        let mut device = 0;
        // SAFETY: it writes to a variable of ours.
        checked("cuCtxGetDevice", unsafe { (self.device)(&raw mut device) })?;
        let mut capability = [0; 2];
        for (value, attribute) in capability.iter_mut().zip(CAPABILITY) {
            // SAFETY: it writes to a variable of ours.
            let failed = unsafe { (self.attribute)(value, attribute, device) };
            checked("cuDeviceGetAttribute", failed)?;
        }
        let architecture = format!("--gpu-architecture=sm_{}{}", capability[0], capability[1]);
        let text =
            |text: &str| CString::new(text).map_err(|error| TchError::Torch(error.to_string()));
        let (source, architecture) = (text(source)?, text(&architecture)?);
        let (mut program, none) = (ptr::null_mut(), ptr::null());
        // SAFETY: the source is a C string, the program a variable of ours; there are no headers.
        let failed = unsafe {
            (self.create)(
                &raw mut program,
                source.as_ptr(),
                none,
                0,
                none.cast(),
                none.cast(),
            )
        };
        checked("nvrtcCreateProgram", failed)?;
        let code = self.compiled(program, &architecture);
        // SAFETY: the program was created, and is used no more.
        let _code = unsafe { (self.destroy)(&raw mut program) };
        code
    }

    /// Machine code of the program; the error has the first line of the compiler's log.
    fn compiled(self, program: *mut c_void, option: &CStr) -> Result<Vec<c_char>, TchError> {
        let options = [option.as_ptr()];
        // SAFETY: the program was created; the option is a C string.
        let failed = unsafe { (self.compile)(program, 1, options.as_ptr()) };
        if failed != 0 {
            let said = self
                .read(program, self.log_size, self.log)
                .unwrap_or_default();
            let said: String = said
                .iter()
                .map(|&byte| char::from(u8::from_ne_bytes(byte.to_ne_bytes())))
                .collect();
            let first = said.lines().next().unwrap_or_default();
            let said = format!("kernels can't be compiled: code {failed}, {first}");
            return Err(TchError::Torch(said));
        }
        self.read(program, self.code_size, self.code)
    }

    /// What `read` writes, as much as `size` says.
    fn read(
        self,
        program: *mut c_void,
        size: unsafe extern "C" fn(*mut c_void, *mut usize) -> c_int,
        read: unsafe extern "C" fn(*mut c_void, *mut c_char) -> c_int,
    ) -> Result<Vec<c_char>, TchError> {
        let mut length = 0;
        // SAFETY: the program was compiled; it writes to a variable of ours.
        checked("nvrtc", unsafe { size(program, &raw mut length) })?;
        let mut bytes = vec![0; length];
        // SAFETY: there is room for as many bytes as it said.
        checked("nvrtc", unsafe { read(program, bytes.as_mut_ptr()) })?;
        Ok(bytes)
    }
}
