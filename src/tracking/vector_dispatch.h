#pragma once

// Code for processors with AVX2 and FMA beside the code for all others, chosen at run time.
#if defined(__x86_64__) && defined(__GNUC__)
#define SCENECALIB_HAS_AVX2_CODE
#define SCENECALIB_AVX2 __attribute__((target("avx2,fma")))
#else
#define SCENECALIB_AVX2
#endif
#ifdef __GNUC__
#define SCENECALIB_ALWAYS_INLINE inline __attribute__((always_inline))
#else
#define SCENECALIB_ALWAYS_INLINE inline
#endif

namespace scenecalib {

inline bool HasAvx2() {
#ifdef SCENECALIB_HAS_AVX2_CODE
  static const bool has = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  return has;
#else
  return false;
#endif
}

}  // namespace scenecalib

/// Defines void name(parameters), which calls body(arguments), a function that is always inlined,
/// as it is compiled for this processor.
#define SCENECALIB_DISPATCHED(name, body, parameters, arguments) \
  void name##Portable parameters { body arguments; }             \
  SCENECALIB_AVX2 void name##Avx2 parameters { body arguments; } \
  void name parameters { HasAvx2() ? name##Avx2 arguments : name##Portable arguments; }
