#pragma once

// SCENECALIB_VECTOR_CLONES before a function compiles it twice: for every processor, and for those
// with AVX2, which the loader chooses where it can. The arithmetic is the same, so are the results.
#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define SCENECALIB_VECTOR_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define SCENECALIB_VECTOR_CLONES
#endif
