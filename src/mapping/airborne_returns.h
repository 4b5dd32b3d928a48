#pragma once

#include "scenecalib/mapping/packed_scan.h"

namespace scenecalib {

/// Share of a scan's returns that hang in the air: snow flakes, rain drops, dust. Such a return is
/// near (within 10 m), most of the beams around it (1.5 degrees to each side) go on well behind
/// where it is, and hardly any ends where it does. Leaves and fences have neighbours at their own
/// range, which a flake has not. Up to some thousands of the near returns are looked at.
double AirborneShare(const PackedScan& scan);

}  // namespace scenecalib
