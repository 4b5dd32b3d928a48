#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace scenecalib {

/// Maps voxel keys to consecutive numbers: an open-addressing table, several times faster than
/// std::unordered_map for the millions of look-ups of a registration. Keys cannot be removed.
class VoxelIndex {
 public:
  static constexpr std::uint32_t kNone = 0xffffffffU;

  VoxelIndex() = default;
  /// Room for so many keys without growing.
  explicit VoxelIndex(std::size_t num_keys) { Grow(2 * num_keys); }

  std::size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }

  /// The key's number, kNone when it is not there.
  std::uint32_t Find(std::uint64_t key) const {
    if (size_ == 0) return kNone;
    for (std::size_t i = Hash(key) & mask_;; i = (i + 1) & mask_) {
      if (entries_[i].key == key) return entries_[i].number;
      if (entries_[i].key == kFree) return kNone;
    }
  }

  /// The key's number; a new key gets size(), which then counts one more.
  std::uint32_t FindOrAdd(std::uint64_t key) {
    if (2 * size_ >= entries_.size()) Grow(2 * entries_.size());
    std::size_t i = Hash(key) & mask_;
    for (; entries_[i].key != kFree; i = (i + 1) & mask_) {
      if (entries_[i].key == key) return entries_[i].number;
    }
    entries_[i] = {key, static_cast<std::uint32_t>(size_)};
    return static_cast<std::uint32_t>(size_++);
  }

  void Clear() { *this = VoxelIndex(); }

 private:
  static constexpr std::uint64_t kFree = ~0ULL;  // keys use 63 bits
  struct Entry {
    std::uint64_t key = kFree;
    std::uint32_t number = kNone;
  };

  static std::size_t Hash(std::uint64_t key) {
    key *= 0x9e3779b97f4a7c15ULL;
    return static_cast<std::size_t>(key ^ (key >> 29));
  }
  void Grow(std::size_t num_entries) {
    std::size_t capacity = 64;
    while (capacity < num_entries) capacity *= 2;
    std::vector<Entry> old(capacity);
    old.swap(entries_);
    mask_ = capacity - 1;
    for (const Entry& entry : old) {
      if (entry.key == kFree) continue;
      std::size_t i = Hash(entry.key) & mask_;
      while (entries_[i].key != kFree) i = (i + 1) & mask_;
      entries_[i] = entry;
    }
  }

  std::vector<Entry> entries_;
  std::size_t mask_ = 0;
  std::size_t size_ = 0;
};

}  // namespace scenecalib
