from std_msgs.msg import Header

class KeyValue:
    key: str
    value: str

class DiagnosticStatus:
    level: bytes
    name: str
    message: str
    hardware_id: str
    values: list[KeyValue]

class DiagnosticArray:
    header: Header
    status: list[DiagnosticStatus]
