#pragma once

#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/evaluation/report_page.h"
#include "scenecalib/pipeline/calibration_pipeline.h"
#include "scenecalib/pipeline/overlays.h"

namespace scenecalib {

/// Gathers what the report shows of a run (evaluation/report_page.h). `overlays` are those of the
/// same run; they are made smaller. Draws the coloured cloud, from behind and above the drive's
/// middle. Unavailable when a picture cannot be encoded.
Result<ReportData> MakeReportData(const PipelineResult& result,
                                  const std::vector<CameraOverlays>& overlays);

/// What the mapping found of the lidar's lasers, in words.
std::string DescribeLasers(const MappingReport& report);

}  // namespace scenecalib
