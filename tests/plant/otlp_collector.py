"""A collector of OTLP over HTTP by opentelemetry-proto: prints a line of JSON a request.

`otlp_collector.py PORT [CERTIFICATE KEY]`; a number on standard input is the status of the answers from then on, `partial` a success less two points.
"""

import http.server
import json
import ssl
import sys
import threading

from opentelemetry.proto.collector.metrics.v1.metrics_service_pb2 import (
    ExportMetricsServiceRequest,
    ExportMetricsServiceResponse,
)

answer = ["200"]


def texts(attributes):
    return {one.key: one.value.string_value for one in attributes}


def point(one):
    return {
        "labels": texts(one.attributes),
        "value": getattr(one, one.WhichOneof("value")),
        "kind": one.WhichOneof("value"),
        "time": one.time_unix_nano,
        "start": one.start_time_unix_nano,
    }


def metric(one):
    kind = one.WhichOneof("data")
    data = getattr(one, kind)
    line = {"unit": one.unit, "help": one.description, "kind": kind, "points": [point(p) for p in data.data_points]}
    if kind == "sum":
        line |= {"cumulative": data.aggregation_temporality == 2, "monotonic": data.is_monotonic}
    return line


class Handler(http.server.BaseHTTPRequestHandler):
    def do_POST(self):
        request = ExportMetricsServiceRequest()
        request.ParseFromString(self.rfile.read(int(self.headers["Content-Length"])))
        (of_resource,) = request.resource_metrics
        (of_scope,) = of_resource.scope_metrics
        line = {
            "path": self.path,
            "type": self.headers["Content-Type"],
            "token": self.headers["Authorization"],
            "host": self.headers["Host"],
            "answer": answer[0],
            "resource": texts(of_resource.resource.attributes),
            "scope": of_scope.scope.name,
            "metrics": {one.name: metric(one) for one in of_scope.metrics},
        }
        response = ExportMetricsServiceResponse()
        code = answer[0]
        if code == "partial":
            code = "200"
            response.partial_success.rejected_data_points = 2
            response.partial_success.error_message = "two too many"
        body = response.SerializeToString()
        self.send_response(int(code))
        self.send_header("Content-Type", "application/x-protobuf")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)
        sys.stdout.write(json.dumps(line) + "\n")  # at once: others may be writing
        sys.stdout.flush()

    def log_message(self, *_):
        pass


server = http.server.ThreadingHTTPServer(("127.0.0.1", int(sys.argv[1])), Handler)
if len(sys.argv) > 2:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(sys.argv[2], sys.argv[3])
    server.socket = context.wrap_socket(server.socket, server_side=True)
threading.Thread(target=server.serve_forever, daemon=True).start()
for word in sys.stdin:
    answer[0] = word.strip()
