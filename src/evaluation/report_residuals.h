#pragma once

#include <string>

#include "scenecalib/evaluation/report_page.h"

namespace scenecalib {

/// The charts of the residuals: by place in the image, by range, by kind of surface.
std::string FormatResiduals(const ReportData& data);

}  // namespace scenecalib
