#include "scenecalib/base/options.h"

#include <gtest/gtest.h>

namespace scenecalib {
namespace {

struct InnerOptions {
  int count = 3;
  void Visit(OptionVisitor& v) { v.Field("count", &count, {1, 5}, "how many"); }
};

struct OuterOptions {
  double size_m = 0.5;
  InnerOptions inner;
  void Visit(OptionVisitor& v) {
    v.Field("size_m", &size_m, {0.1, 1.0}, "how large");
    v.Group("inner", &inner);
  }
};

TEST(Options, AreDescribedWithDottedKeysInDeclarationOrder) {
  const auto descriptions = DescribeOptions(OuterOptions());
  ASSERT_EQ(descriptions.size(), 2u);
  EXPECT_EQ(descriptions[0].key, "size_m");
  EXPECT_EQ(descriptions[1].key, "inner.count");
  EXPECT_EQ(descriptions[1].value, "3");
}

TEST(Options, OutOfRangeValueIsNamedWithKeyValueAndBound) {
  OuterOptions options;
  options.inner.count = 9;
  const Status status = CheckOptions(options);
  ASSERT_FALSE(status.ok());
  EXPECT_EQ(status.message(), "option inner.count is 9, must be in [1, 5]");
}

TEST(Options, NanIsOutOfRange) {
  OuterOptions options;
  options.size_m = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(CheckOptions(options).ok());
}

}  // namespace
}  // namespace scenecalib
