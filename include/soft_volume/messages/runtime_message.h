#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace soft_volume {

/// Values of a message by the dotted names of their fields, such as `pose.position.x` or `header.stamp.secs`. Arrays
/// are left out.
class RuntimeFields {
 public:
  /// Numbers and booleans (0 or 1). Throws core::InputError when the message has no such number.
  double number(const std::string& field) const;
  /// Throws core::InputError when the message has no such text.
  const std::string& text(const std::string& field) const;

 private:
  friend class RuntimeLayout;
  std::map<std::string, double> numbers_;
  std::map<std::string, std::string> texts_;
};

/// Reads messages of a type that is known at run time only, by what its publisher says of it: so that drivers whose
/// message packages are not installed here can be heard, and fields are found by name whatever stands around them.
class RuntimeLayout {
 public:
  /// `type` is "package/Name"; `definition` is the text of a connection header: the message's own definition and, each
  /// after a line of = and a line `MSG: package/Name`, those of the types in it. Throws core::InputError when it cannot
  /// be understood.
  RuntimeLayout(const std::string& type, const std::string& definition);

  const std::string& type() const { return type_; }

  /// Throws core::InputError when the bytes are no whole message of this type.
  RuntimeFields read(const std::uint8_t* data, std::size_t size) const;

 private:
  enum class Kind { kInteger, kUnsigned, kFloat, kText, kMessage };
  struct Field {
    std::string name;
    Kind kind = Kind::kMessage;
    std::size_t bytes = 0;  // of a number
    bool is_array = false;
    std::uint32_t length = 0;   // of an array; 0: the message says
    std::vector<Field> fields;  // of a message
  };
  using Definitions = std::map<std::string, std::string>;
  class Reader;

  static std::vector<Field> parse(const std::string& type, const Definitions& definitions, int depth);
  static Field parseField(const std::string& field_type, const std::string& name, const std::string& package,
                          const Definitions& definitions, int depth);

  std::string type_;
  std::vector<Field> fields_;
};

}  // namespace soft_volume
