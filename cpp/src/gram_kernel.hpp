// Products of columns; part of kernels.cpp, see there.
#pragma once

#include <cstddef>

#include "monoloc/kernels.hpp"
#include "simd.hpp"

namespace monoloc {
namespace {

// The eight sums of a tile stay in registers. Tiles are near square.
constexpr std::size_t kTileVectors = kWide64 < 8 ? 2 : 1, kTileRows = 8 / kTileVectors;
constexpr std::size_t kTileColumns = kTileVectors * kWide64;
static_assert(kPadding % kTileRows == 0 && kPadding % kTileColumns == 0, "whole tiles");

void add_gram(const double* rows, std::size_t count, std::size_t columns, std::size_t stride, double* out) {
  for (std::size_t i = 0; i < columns; i += kTileRows) {
    for (std::size_t j = i / kTileColumns * kTileColumns; j < columns; j += kTileColumns) {
      DW sums[kTileRows][kTileVectors];
      for (std::size_t a = 0; a < kTileRows; ++a) {
        for (std::size_t b = 0; b < kTileVectors; ++b) sums[a][b] = load<DW>(out + (i + a) * stride + j + b * kWide64);
      }
      for (std::size_t k = 0; k < count; ++k) {
        const double* row = rows + k * stride;
        for (std::size_t b = 0; b < kTileVectors; ++b) {
          const DW column = load<DW>(row + j + b * kWide64);
          for (std::size_t a = 0; a < kTileRows; ++a) sums[a][b] += row[i + a] * column;
        }
      }
      for (std::size_t a = 0; a < kTileRows; ++a) {
        for (std::size_t b = 0; b < kTileVectors; ++b) store(out + (i + a) * stride + j + b * kWide64, sums[a][b]);
      }
    }
  }
}

}  // namespace
}  // namespace monoloc
